"""The I2C bus: bytes on the wire, their timing, and all faults."""

import errno

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.boards.virtual.hardware.clock import ManualClock
from uros.boards.virtual.hardware.i2c import FAULTS, STRETCH_US, BusError, Device, I2CBus


class Memory(Device):
    """A device that returns the bytes 1, 2, 3 …, and accepts four in each transfer."""

    def __init__(self, name="memory", address=0x50, hold=0):
        super().__init__(name, address)
        self.log = []
        self.hold = hold
        self.next = 0
        self.times = []

    def start(self, read):
        self.log.append("R" if read else "W")
        self.taken = 0
        return True

    def write(self, byte):
        self.taken += 1
        self.log.append(byte)
        self.times.append(self.now_us())
        return self.taken <= 4

    def read(self):
        self.next += 1
        return self.next & 0xFF

    def hold_us(self):
        return self.hold

    def stop(self):
        self.log.append("P")


@pytest.fixture
def clock():
    return ManualClock()


@pytest.fixture
def bus(clock):
    bus = I2CBus(clock=clock)
    bus.attach(Memory())
    return bus


def fails(bus, number, address=0x50, write=b"\x01", read=2):
    with pytest.raises(BusError) as caught:
        bus.transfer(address, write, read)
    assert caught.value.errno == number
    return str(caught.value)


def test_write_then_read_with_a_repeated_start(bus):
    assert bus.transfer(0x50, b"\x07\x08", 3) == b"\x01\x02\x03"
    assert bus.devices[0x50].log == ["W", 7, 8, "R", "P"]


def test_the_duration_of_a_transfer_is_that_of_its_bits(bus, clock):
    bus.transfer(0x50, b"\x07\x08", 3)
    bits = 10 + 2 * 9 + 10 + 3 * 9 + 1
    assert clock.world_us() == bits * 10
    bus.frequency = 400_000
    before = clock.world_us()
    bus.transfer(0x50, b"", 8)
    assert clock.world_us() - before == 83 * 10 / 4 + 0.5  # rounded up


def test_a_device_sees_the_time_of_the_wire(bus, clock):
    bus.transfer(0x50, b"\x07\x08", 0)
    assert bus.devices[0x50].times == [190, 280]
    assert bus.devices[0x50].now_us() == clock.world_us() == 290


def test_only_the_address(bus):
    assert bus.transfer(0x50, b"", 0) == b""
    assert bus.devices[0x50].log == ["W", "P"]


def test_without_a_stop_the_bus_stays_claimed(bus):
    second = Memory("other", 0x51)
    bus.attach(second)
    bus.transfer(0x50, b"\x07", 0, stop=False)
    assert bus.devices[0x50].log == ["W", 7]
    bus.transfer(0x50, b"", 1, stop=False)
    assert bus.devices[0x50].log == ["W", 7, "R"]
    bus.transfer(0x51, b"", 1)
    assert bus.devices[0x50].log == ["W", 7, "R", "P"]
    assert second.log == ["R", "P"]


def test_scan(bus):
    bus.attach(Memory("low", 0x08))
    bus.attach(Memory("high", 0x77))
    assert bus.scan() == [0x08, 0x50, 0x77]
    bus.detach(0x50)
    assert bus.scan() == [0x08, 0x77]


def test_an_address_is_taken_once(bus):
    with pytest.raises(ValueError, match="0x50 is taken by memory"):
        bus.attach(Memory("second"))


def test_invalid_addresses_and_counts_are_refused(bus):
    for address, read in ((-1, 0), (128, 0), (0x50, -1)):
        with pytest.raises(ValueError):
            bus.transfer(address, b"", read)


def test_no_device_at_an_address(bus, clock):
    assert "0x51" in fails(bus, errno.ENODEV, address=0x51)
    assert clock.world_us() == 110


def test_a_byte_that_is_not_acknowledged(bus, clock):
    assert "memory does not acknowledge byte 5" in fails(bus, errno.EIO, write=b"12345678")
    assert clock.world_us() == (10 + 5 * 9 + 1) * 10
    assert bus.devices[0x50].log[-1] == "P"


def test_reads_are_reported_at_their_end(bus, clock):
    reads = []
    bus.on_read = lambda address, ns: reads.append((address, ns, clock.host_ns()))
    bus.transfer(0x50, b"\x01", 0)
    assert not reads and bus.last_read is None
    bus.transfer(0x50, b"\x01", 2)
    ns = clock.host_ns()
    assert reads == [(0x50, ns, ns)]
    assert bus.last_read == (0x50, ns)
    fails(bus, errno.ENODEV, address=0x51)
    assert bus.last_read == (0x50, ns)


def test_a_device_may_hold_the_clock(clock):
    bus = I2CBus(clock=clock)
    bus.attach(Memory(hold=99_000))
    bus.transfer(0x50, b"", 1)
    assert clock.world_us() == 99_000 + 200


def test_a_device_cannot_hold_the_clock_beyond_the_time_out(clock):
    bus = I2CBus(clock=clock)
    bus.attach(Memory(hold=100_000))
    assert "memory held the clock line for 100 ms" in fails(bus, errno.ETIMEDOUT, write=b"")
    assert clock.world_us() == 100_000


def test_a_transfer_longer_than_the_time_out_fails(bus, clock):
    fails(bus, errno.ETIMEDOUT, write=b"", read=1111)
    assert clock.world_us() == 100_000
    bus.timeout_us = 200_000
    assert len(bus.transfer(0x50, b"", 1111)) == 1111


# Faults.


def inject(bus, kind):
    bus.devices[0x50].faults.add(kind)


def heal(bus):
    bus.devices[0x50].faults.clear()


def works(bus):
    memory = bus.devices[0x50]
    expected = bytes((memory.next + n) & 0xFF for n in (1, 2, 3))
    return bus.transfer(0x50, b"\x01", 3) == expected


def test_absent(bus):
    inject(bus, "absent")
    fails(bus, errno.ENODEV)
    fails(bus, errno.ENODEV, write=b"")
    assert bus.scan() == []
    heal(bus)
    assert works(bus)


def test_nack(bus):
    inject(bus, "nack")
    fails(bus, errno.EIO)
    fails(bus, errno.ENODEV, write=b"")
    assert bus.scan() == [0x50]
    heal(bus)
    assert works(bus)


def test_stretch_ends_by_itself_after_the_time_out(bus, clock):
    second = Memory("other", 0x51)
    bus.attach(second)
    inject(bus, "stretch")
    bus.transfer(0x50, b"\x01", 0)  # only reads
    before = clock.world_us()
    fails(bus, errno.ETIMEDOUT)
    assert clock.world_us() - before == bus.timeout_us
    assert bus.scl == 0
    bus.transfer(0x51, b"", 1)  # waits for the clock line
    assert STRETCH_US < clock.world_us() - before < STRETCH_US + 1000
    assert bus.scl == 1
    heal(bus)
    assert works(bus)


def test_a_stuck_device_blocks_the_bus_until_recovery(bus, clock):
    bus.attach(Memory("other", 0x51))
    inject(bus, "stuck")
    assert bus.sda == 1
    before = clock.world_us()
    assert "memory held the data line" in fails(bus, errno.ETIMEDOUT)
    assert clock.world_us() - before == bus.timeout_us
    assert bus.sda == 0
    assert "the data line was low" in fails(bus, errno.ETIMEDOUT, address=0x51)
    with pytest.raises(BusError) as caught:
        bus.scan()
    assert caught.value.errno == errno.ETIMEDOUT
    assert bus.recover() is True
    assert bus.sda == 1
    bus.transfer(0x51, b"", 1)
    fails(bus, errno.ETIMEDOUT)  # the fault is still there
    heal(bus)
    assert works(bus)


def test_recovery_by_hand_takes_at_most_nine_clocks(bus):
    counts = set()
    inject(bus, "stuck")
    for _ in range(50):
        fails(bus, errno.ETIMEDOUT)
        count = 0
        while not bus.sda:
            bus.pulse()
            count += 1
        counts.add(count)
    assert counts == set(range(1, 10))


def test_a_stuck_device_that_is_detached_releases_the_bus(bus):
    inject(bus, "stuck")
    fails(bus, errno.ETIMEDOUT)
    bus.detach(0x50)
    assert bus.sda == 1
    assert bus.scan() == []


def test_a_short_is_not_recovered(bus):
    bus.fault("stuck")
    fails(bus, errno.ETIMEDOUT)
    assert bus.recover() is False
    fails(bus, errno.ETIMEDOUT)
    bus.heal()
    assert bus.recover() is True
    assert works(bus)
    with pytest.raises(ValueError, match="no fault noise; it has stuck"):
        bus.fault("noise")


def read_with(kind, seed=0):
    bus = I2CBus(timeout_us=10**6, clock=ManualClock(), seed=seed)
    bus.attach(Memory())
    inject(bus, kind)
    return bus.transfer(0x50, b"", 800)


RIGHT = bytes(n & 0xFF for n in range(1, 801))


def test_noise_flips_single_bits():
    wrong = [(a ^ b).bit_count() for a, b in zip(read_with("noise"), RIGHT, strict=True) if a != b]
    assert set(wrong) == {1}
    assert 150 < len(wrong) < 250


def test_rubbish_is_independent_of_the_device():
    out = read_with("rubbish")
    assert sum(a == b for a, b in zip(out, RIGHT, strict=True)) < 20
    assert len(set(out)) > 200


@pytest.mark.parametrize("kind", ["noise", "rubbish"])
def test_faults_come_from_the_seed(kind):
    assert read_with(kind) == read_with(kind)
    assert read_with(kind) != read_with(kind, seed=1)


@given(
    st.lists(
        st.one_of(
            st.tuples(
                st.sampled_from((0x50, 0x51, 0x00, 0x7F)),
                st.binary(max_size=6),
                st.integers(0, 1200),
                st.booleans(),
            ),
            st.sampled_from([*FAULTS, "heal", "recover", "short"]),
        ),
        max_size=12,
    )
)
def test_any_transfer_ends_within_the_time_out_with_data_or_a_bus_error(steps):
    clock = ManualClock()
    bus = I2CBus(clock=clock)
    bus.attach(Memory())
    bus.attach(Memory("slow", 0x51, hold=2500))
    for step in steps:
        if step == "heal":
            heal(bus)
            bus.heal()
        elif step == "recover":
            bus.recover()
        elif step == "short":
            bus.fault("stuck")
        elif isinstance(step, str):
            inject(bus, step)
        else:
            before = clock.world_us()
            try:
                assert len(bus.transfer(*step)) == step[2]
            except BusError as error:
                assert error.errno in (errno.ENODEV, errno.EIO, errno.ETIMEDOUT)
            assert clock.world_us() - before <= bus.timeout_us
    heal(bus)
    bus.heal()
    clock.advance(STRETCH_US)
    assert works(bus)
