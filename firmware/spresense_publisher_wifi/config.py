"""Settings of the modem, the network and the agent."""

MODEM = "gs2200"  # or "esp8266"
SSID = "robots"
PASSWORD = "secret99"
AGENT = "192.168.1.10"  # the computer with the agent
PORT = 8888
