"""Settings of a rover. See README.md of sprturtlebot for the wiring."""

# The network, and the visualiser in it.
SSID = "robots"
PASSWORD = "secret99"
VISUALISER = "192.168.1.10"
PORT = 10001
# Send speeds and remarks besides the torques. uros pid reads them; the document's
# pid_visualizer.py does not.
EXTENDED = True

# The board: an LED, the motors' supply, and of each side the two inputs of the driver and the
# encoder.
LED0 = 38
MOTOR_POWER = 48
RIGHT, RIGHT_ENCODER = (1, 2), 3
LEFT, LEFT_ENCODER = (42, 47), 46

# The body, in metres: the wheels' radii and half the track. uros calibrate finds yours.
RIGHT_RADIUS = 0.0325
LEFT_RADIUS = 0.0325
D = 0.134
FASTEST = 0.9  # of a wheel, m/s

# The control of each wheel; kp, ki and kd are tuned. Copy the tuned values to the config.py of
# sprturtlebot.
RIGHT_PID = {"kp": 150, "ki": 1000, "kd": 0, "dead_zone": 21, "kf": 214, "lag": 0.15}
LEFT_PID = {"kp": 150, "ki": 1000, "kd": 0, "dead_zone": 21, "kf": 214, "lag": 0.15}
DRIVE_MS = 2000  # how long a line of gains is driven
