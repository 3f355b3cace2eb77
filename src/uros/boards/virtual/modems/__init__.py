"""Radio modems of virtual boards, and the network behind them.

=================  =============================================================================
``esp8266``        An ESP8266 with Espressif's AT firmware on a UART: AT commands and responses
``gs2200``         A GS2200 on an SPI bus: transfers, AT commands and responses
``modem``          What the modelled modems share: the association with an access point, one UDP
                   link, and delayed responses
``radio_network``  The network that virtual radio modems reach: access points, and UDP links to
                   the hosts behind them
=================  =============================================================================
"""
