"""Radio modems of virtual boards, and the network behind them.

=================  =============================================================================
``esp8266``        An ESP8266 with Espressif's AT firmware, on the other end of a UART: commands
                   and what it says
``gs2200``         A GS2200 on the other end of an SPI bus: its transfers, its commands and what
                   it says
``modem``          What modelled modems share: being in a network, a link there, and answers
                   that take their time
``radio_network``  What radio modems of virtual boards reach: access points, and hosts behind
                   them
=================  =============================================================================
"""
