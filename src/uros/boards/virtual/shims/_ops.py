"""The operations that the virtual board carries out. Integers are little-endian."""

#                   data                                        answer
CONSOLE = 1  #      text                                        nothing
TICKS_MS = 2  #     nothing                                     number, modulo 2^30
TICKS_US = 3  #     nothing                                     number, modulo 2^30
EPOCH = 4  #        nothing                                     i64 nanoseconds since 2000
SLEEP = 5  #        u32 microseconds                            number: microseconds left when an
#                                                               interrupt is due before the end
I2C_INIT = 6  #     u8 channel, u32 Hz, u32 timeout in us       nothing
I2C_TRANSFER = 7  # u8 channel, u8 address, u8 stop, u16 octets
#                   to read, what to write                      what was read
I2C_SCAN = 8  #     u8 channel                                  addresses, an octet each
PIN_MODE = 9  #     u8 mode, u8 pull, name; 255: as it is       nothing
PIN_SET = 10  #     u8 level, name                              nothing
PIN_GET = 11  #     name                                        number: level
USB_ENABLE = 12  #  u16 length and device descriptor, u16 length
#                   and configuration, strings each with a NUL  nothing
USB_DISABLE = 13  # nothing                                     nothing
USB_STATE = 14  #   nothing                                     number: the state, see below
USB_WRITE = 15  #   octets                                      number: how many were taken
USB_READ = 16  #    u16 at most                                 octets
USB_ANY = 17  #     nothing                                     number: octets to read
USB_WAIT = 18  #    u32 microseconds, u8 states to wait for     number: the states, once one of them
#                                                               is reached or the time is up
RESET = 19  #       u8: 1 hard, 0 soft                          none: the program starts anew
UNIQUE_ID = 20  #   nothing                                     octets
FREQUENCY = 21  #   nothing                                     number: Hz
ENDED = 22  #       the traceback, or nothing                   nothing
HEAP = 23  #        text: octets in use, peak                   nothing
UART_INIT = 24  #   u8 number, u32 baud, u32 octets of buffer,
#                   names of the pins tx, NUL, rx; "": default  nothing
UART_WRITE = 25  #  u8 number, octets                           number: how many were taken
UART_READ = 26  #   u8 number, u16 at most                      octets
UART_ANY = 27  #    u8 number                                   number: octets to read
SPI_INIT = 28  #    u8 number, u8 mode 0 to 3                   nothing
SPI_WRITE = 29  #   u8 number, octets                           nothing
SPI_READ = 30  #    u8 number, u8 to send meanwhile, u16 count  octets
WLAN_CONNECT = 31  # name, NUL, password                        nothing
WLAN_LEAVE = 32  #  nothing                                     nothing
WLAN_STATUS = 33  # nothing                                     number: 0 idle, 1 joining, 2 wrong
#                                                               password, 3 no such network, 4 in it
NET_OPEN = 34  #    u8: 1 TCP, 2 UDP                            number: handle
NET_CONNECT = 35  # u8 handle, u16 port, host                   nothing
NET_SEND = 36  #    u8 handle, octets                           number: how many were taken
NET_RECV = 37  #    u8 handle, u16 at most                      octets
NET_CLOSE = 38  #   u8 handle                                   nothing
NET_WAIT = 39  #    u32 microseconds, u8 handle, u8 events      number: the events that are ready
WLAN_START = 40  #  as WLAN_CONNECT, of an access point; NUL,
#                   its own address                             nothing
WLAN_STOP = 41  #   nothing                                     nothing
WLAN_GUESTS = 42  # nothing                                     number: how many have joined it
PIN_IRQ = 43  #     u8 1 rising, 2 falling or both, name        number of the pin
IRQ_NEXT = 44  #    nothing                                     number: 2 * pin + level of the next
#                                                               interrupt that is due, 0: none
PWM_SET = 45  #     u32 Hz, u16 duty, name                      nothing
PWM_OFF = 46  #     name                                        nothing
ADC_READ = 47  #    name                                        number: 0 to 65535
CAMERA = 48  #      u16 width, u16 height, u8 quality           a JPEG, or nothing: it failed
EPOCH_SET = 49  #   i64 nanoseconds since 2000                  nothing
CORE_START = 50  #  name of a module                            nothing
MAIL_SEND = 51  #   u8 mailbox, u8 number, octets               nothing
MAIL_RECEIVE = 52  # u8 mailbox                                 u8 number, octets; nothing: no mail
RESET_CAUSE = 53  # nothing                                     number: machine.reset_cause()
WDT_FEED = 54  #    u32 milliseconds; starts it, 0: as before   nothing
DEEPSLEEP = 55  #   u32 milliseconds; 0: for ever               none: the program starts anew
NET_BIND = 57  #    u8 handle, u16 port                         nothing
RTC_MEMORY = 56  #  nothing, or u8 1 and octets to store        octets, or nothing
UART_WAIT = 58  #   u8 number, u16 at most, u32 microseconds    octets, once there are any or the
#                                                               time is up
ADVICE = 59  #      u8 operation that failed, name              text: what the board has instead

# States of USB, added up.
USB_OPEN = 1  # configured by the host
USB_READABLE = 2
USB_WRITABLE = 4
USB_DTR = 8  # a program on the host has opened the port
USB_CLOSED = 16  # not open
