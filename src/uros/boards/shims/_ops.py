"""What the firmware can ask the virtual board for. Integers are little-endian."""

#                   data                                        answer
CONSOLE = 1  #      text                                        nothing
TICKS_MS = 2  #     nothing                                     number, modulo 2^30
TICKS_US = 3  #     nothing                                     number, modulo 2^30
EPOCH = 4  #        nothing                                     i64 nanoseconds since 2000
SLEEP = 5  #        u64 microseconds                            nothing, after that time
I2C_INIT = 6  #     u8 channel, u32 Hz, u32 timeout in us       nothing
I2C_TRANSFER = 7  # u8 channel, u8 address, u8 stop, u16 octets
#                   to read, what to write                      what was read
I2C_SCAN = 8  #     u8 channel                                  addresses, an octet each
PIN_MODE = 9  #     u8 mode, name                               nothing
PIN_SET = 10  #     u8 level, name                              nothing
PIN_GET = 11  #     name                                        number: level
USB_ENABLE = 12  #  u16 length and device descriptor, u16 length
#                   and configuration, strings each with a NUL  nothing
USB_DISABLE = 13  # nothing                                     nothing
USB_STATE = 14  #   nothing                                     number: the state, see below
USB_WRITE = 15  #   octets                                      number: how many were taken
USB_READ = 16  #    u16 at most                                 octets
USB_ANY = 17  #     nothing                                     number: octets to read
USB_WAIT = 18  #    u32 microseconds, u8 states to wait for     number: state, when one of them is
#                                                               there or the time is up
RESET = 19  #       u8: 1 hard, 0 soft                          none: the program starts anew
UNIQUE_ID = 20  #   nothing                                     octets
FREQUENCY = 21  #   nothing                                     number: Hz
ENDED = 22  #       the traceback, or nothing                   nothing
HEAP = 23  #        text: octets in use, peak                   nothing

# States of USB, added up.
USB_OPEN = 1  # configured by the host
USB_READABLE = 2
USB_WRITABLE = 4
USB_DTR = 8  # a program on the host has opened the port
USB_CLOSED = 16  # not open
