"""Settings of a rover. See README.md for the wiring."""

# The network, and the agent in it.
SSID = "robots"
PASSWORD = "secret99"
AGENT = "192.168.1.10"
PORT = 8888

# The board: LEDs, the modem (SPI 1), the motors' supply, and of each side the two inputs of the
# driver and the encoder.
LED0, LED2 = 38, 40
SCK, MOSI, MISO, CS, DATA_READY = 36, 35, 37, 21, 14
MOTOR_POWER = 48
RIGHT, RIGHT_ENCODER = (1, 2), 3
LEFT, LEFT_ENCODER = (42, 47), 46
CAMERA = {
    "data_pins": [11, 9, 8, 10, 12, 18, 17, 16],
    "xclk_pin": 15, "pclk_pin": 13, "vsync_pin": 6, "href_pin": 7, "sda_pin": 4, "scl_pin": 5,
}  # fmt: skip

# The body, in metres: the wheels' radii and half the track. uros calibrate finds yours.
RIGHT_RADIUS = 0.0325
LEFT_RADIUS = 0.0325
D = 0.134
FASTEST = 0.9  # of a wheel, m/s

# The control of each wheel, in duties (of 255) for 1 m/s: see uros.control.pid.
# firmware/sprturtlebot_pid finds the gains of your motors.
RIGHT_PID = {"kp": 150, "ki": 1000, "kd": 0, "dead_zone": 21, "kf": 214, "lag": 0.15}
LEFT_PID = {"kp": 150, "ki": 1000, "kd": 0, "dead_zone": 21, "kf": 214, "lag": 0.15}
