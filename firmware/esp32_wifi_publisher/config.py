"""The board's access point, and the address of the agent in its network."""

SSID = "ESP32-Access-Point"
PASSWORD = "123456789"  # 8 to 63 characters
ADDRESS = "10.16.1.1"  # the board's own
AGENT = "10.16.1.2"  # the first address that the board assigns
AGENT_PORT = 8888
