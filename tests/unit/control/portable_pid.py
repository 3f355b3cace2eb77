"""The PID controller alone, and with a first-order motor."""

from support.portable import SINGLE_FLOATS

from uros.control.pid import Pid


def near(value, wanted, within=1e-6):
    if SINGLE_FLOATS:
        within = max(within, 1e-6 * abs(wanted))
    assert abs(value - wanted) <= within, (value, wanted)


def test_proportional_integral_and_derivative_parts():
    pid = Pid(100, 0)
    near(pid.step(0.5, 0.2, 0.02), 30)
    pid = Pid(0, 50)
    # Trapezoids: from 0 to 0.4, then from 0.4 to 0.2.
    near(pid.step(0.4, 0.0, 0.1), 50 * 0.02)
    near(pid.step(0.4, 0.2, 0.1), 50 * (0.02 + 0.03))
    pid = Pid(0, 0, 2)
    pid.step(0.5, 0.2, 0.1)
    near(pid.step(0.5, 0.1, 0.1), 2)


def test_a_new_target_causes_no_jump_of_the_derivative():
    pid = Pid(0, 0, 100)
    pid.step(0.1, 0.1, 0.02)
    near(pid.step(0.9, 0.1, 0.02), 0)


def test_the_dead_zone_has_the_targets_sign():
    pid = Pid(0, 0, dead_zone=30, kf=200)
    near(pid.step(0.1, 0.0, 0.02), 50)
    near(pid.step(-0.1, 0.0, 0.02), -50)
    near(pid.step(0.0, 0.0, 0.02), 0)


def test_the_output_stays_within_the_limit_and_has_the_targets_sign():
    pid = Pid(1000, 0, limit=255)
    near(pid.step(1.0, 0.0, 0.02), 255)
    near(pid.step(-1.0, 0.0, 0.02), -255)
    # Too fast: brake, but do not drive backward.
    near(pid.step(0.1, 0.5, 0.02), 0)
    near(pid.step(-0.1, -0.5, 0.02), 0)


def test_an_integral_does_not_grow_at_the_limit():
    pid = Pid(100, 400)
    for _ in range(1000):
        pid.step(1.0, 0.0, 0.02)
    assert abs(pid.ki * pid.integral) <= 255
    # The output leaves the limit within a second, not after 20.
    outputs = [pid.step(1.0, 1.1, 0.02) for _ in range(40)]
    assert outputs[-1] < 250, outputs


def test_the_integral_is_held_while_the_output_is_saturated():
    pid = Pid(1000, 10)
    for _ in range(100):
        near(pid.step(1.0, 0.0, 0.02), 255)
    near(pid.integral, 0)
    # Errors that reduce the output are integrated.
    pid.kp = 1
    pid.step(1.0, 0.9, 0.02)
    pid.step(1.0, 0.9, 0.02)
    assert pid.integral > 0


def test_gains_may_change_while_the_controller_runs():
    pid = Pid(10, 100)
    for _ in range(100):
        pid.step(1.0, 0.0, 0.02)
    pid.ki = 10000
    pid.step(1.0, 1.0, 0.02)
    assert pid.ki * pid.integral <= 255.1


def test_reset_clears_the_state():
    pid = Pid(100, 400, 3, lag=0.2)
    for _ in range(10):
        pid.step(0.5, 0.1, 0.02)
    pid.reset()
    assert pid.integral == pid.error == pid.output == pid.expected == 0
    first = pid.step(0.5, 0.1, 0.02)
    fresh = Pid(100, 400, 3, lag=0.2)
    near(first, fresh.step(0.5, 0.1, 0.02))


def test_the_reference_model_prevents_an_error_during_acceleration():
    pid = Pid(100, 1000, lag=0.2)
    speed = 0.0
    for _ in range(50):
        speed += (0.5 - speed) * 0.02 / 0.22
        near(pid.step(0.5, speed, 0.02), 0, 1e-3)


def test_an_unknown_speed_is_taken_as_expected():
    pid = Pid(100, 1000, dead_zone=20, kf=200, lag=0.2)
    near(pid.step(0.5, 0.0, 0.02, False), 120)
    near(pid.integral, 0)


def test_the_controller_compensates_a_motor_that_differs_from_its_model():
    # The motor is 20 % weaker than its model and has more friction.
    pid = Pid(150, 1000, dead_zone=21, kf=214, lag=0.13)
    speed = 0.0
    most = 0.0
    for step in range(60):
        duty = pid.step(0.3, speed, 0.02)
        for _ in range(20):
            speed += (max(duty - 27, 0) / 260 - speed) * 0.001 / 0.11
        most = max(most, speed)
        if step > 30:
            near(speed, 0.3, 0.02)
    assert most < 0.33, most
