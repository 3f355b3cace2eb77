"""Which faults of a transport are logged; all of them are counted."""

from uros.agent.transports.fault_counter import FaultCounter


def test_the_first_the_second_the_fourth_fault_is_logged():
    faults = FaultCounter()
    logged = [number for number in range(1, 101) if faults.add()]
    assert logged == [1, 2, 4, 8, 16, 32, 64] and faults.count == 100
