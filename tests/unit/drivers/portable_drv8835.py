"""The driver of the DRV8835 on PWMs that record their duties."""

from uros.drivers.drv8835 import DRV8835


class Pwm:
    duty = None

    def duty_u16(self, duty):
        self.duty = duty


def bridge_of_two():
    first, second = Pwm(), Pwm()
    return DRV8835(first, second), first, second


def test_the_bridge_coasts_at_first():
    _, first, second = bridge_of_two()
    assert (first.duty, second.duty) == (0, 0)


def test_duties_of_driving_and_braking():
    bridge, first, second = bridge_of_two()
    for duty, wanted in (
        (0, (65535, 65535)),
        (255, (65535, 0)),
        (-255, (0, 65535)),
        (51, (65535, 52428)),
        (-51.0, (52428, 65535)),
        (1000, (65535, 0)),
        (-1e9, (0, 65535)),
    ):
        bridge.drive(duty)
        assert (first.duty, second.duty) == wanted, (duty, first.duty, second.duty)


def test_coast_switches_both_outputs_off():
    bridge, first, second = bridge_of_two()
    bridge.drive(100)
    bridge.coast()
    assert (first.duty, second.duty) == (0, 0)
