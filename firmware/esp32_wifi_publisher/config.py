"""The network that the board makes, and where the agent is in it."""

SSID = "ESP32-Access-Point"
PASSWORD = "123456789"  # 8 to 63 characters
ADDRESS = "10.16.1.1"  # the board's own
AGENT = "10.16.1.2"  # the first that the board gives away
AGENT_PORT = 8888
