"""Boards on the market, and the MicroPython port of each, or why it has none.

These are the boards that micro-ROS's tutorials name. ``docs/ports.md`` has first steps for each.
Virtual boards (`uros.boards.virtual.hardware.board`) do not use this table.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class NamedBoard:
    """A board on the market.

    Args:
        name: Key in `NAMED`.
        title: Manufacturer and product name.
        mcu: Microcontroller.
        ram: Size of its RAM, with unit.
        port: MicroPython's name of the port; empty if there is none.
        image: MicroPython's name of the firmware image to download.
        note: What to know about console and agent lines; without a port, the reason and an
            alternative.
        other: Other names that `find` accepts.
    """

    name: str
    title: str
    mcu: str
    ram: str
    port: str
    image: str
    note: str
    other: tuple[str, ...] = ()


PLATFORMS: Final = {
    "renesas-ra": "renesas-ra",
    "esp32": "esp32",
    "rp2": "rp2",
    "pyboard": "stm32",
}
"""``sys.platform`` of each port. The stm32 port still has the name of its first board."""

_INSTEAD: Final = (
    "Take a Raspberry Pi Pico or an ESP32, and leave to this board what it does well: let it read"
    " its sensors, and a node on the host (import uros) publish what it prints"
)

NAMED: Final = {
    board.name: board
    for board in (
        NamedBoard(
            "ek_ra6m5", "Renesas EK-RA6M5", "R7FA6M5BH3CFC", "512 kB", "renesas-ra", "VK_RA6M5",
            "MicroPython has no image for EK-RA6M5; VK-RA6M5's has the same microcontroller, its"
            " console on UART 9 (P109, P110), and no USB",
            ("ra6m5",),
        ),
        NamedBoard(
            "esp32", "ESP32 boards, such as ESP32-DevKitC", "ESP32", "520 kB", "esp32",
            "ESP32_GENERIC",
            "the console has UART 0 and the USB socket; Wi-Fi is free for the agent",
            ("esp32_devkit", "esp32_devkitc", "esp32_generic"),
        ),
        NamedBoard(
            "esp32_s3", "ESP32-S3 boards, such as ESP32-S3-DevKitC-1", "ESP32-S3", "512 kB",
            "esp32", "ESP32_GENERIC_S3",
            "the console has the USB socket of the chip itself; the agent gets the other one, UART"
            " 1 on pins 43 and 44. Of the variants with PSRAM take N8R2: pins 35 to 37 are free"
            " there. A camera needs the image of micropython-camera-API",
            ("esp32s3", "esp32_s3_devkitc_1", "esp32_generic_s3", "esp32_s3_devkitc"),
        ),
        NamedBoard(
            "hackerboard", "Manchester Robotics Hackerboard", "ESP32", "520 kB", "esp32",
            "ESP32_GENERIC", "an ESP32 as any other; the console has its USB socket",
            ("manchester_hackerboard", "mcr2_hackerboard"),
        ),
        NamedBoard(
            "pico", "Raspberry Pi Pico", "RP2040", "264 kB", "rp2", "RPI_PICO",
            "the console has USB; the agent gets UART 0 (GP0, GP1) or a second USB line"
            " (micropython-lib's usb-device-cdc)",
            ("raspberry_pi_pico", "rpi_pico", "rp2040"),
        ),
        NamedBoard(
            "pico_w", "Raspberry Pi Pico W", "RP2040", "264 kB", "rp2", "RPI_PICO_W",
            "the console has USB; Wi-Fi is free for the agent",
            ("raspberry_pi_pico_w", "rpi_pico_w"),
        ),
        NamedBoard(
            "olimex_e407", "Olimex STM32-E407", "STM32F407ZG", "192 kB", "stm32", "OLIMEX_E407",
            "the console has USB (OTG 1); the agent gets UART 6, UART 3 or Ethernet",
            ("stm32", "stm32_e407", "olimex"),
        ),
        NamedBoard(
            "nucleo_f446re", "ST NUCLEO-F446RE", "STM32F446RE", "128 kB", "stm32", "NUCLEO_F446RE",
            "the console has UART 2, which is the ST-Link's USB socket; the agent gets UART 1"
            " (D10, D2) by an adapter",
            ("nucleo",),
        ),
        NamedBoard(
            "nucleo_f767zi", "ST NUCLEO-F767ZI", "STM32F767ZI", "512 kB", "stm32", "NUCLEO_F767ZI",
            "the console has UART 3, which is the ST-Link's USB socket; the agent gets Ethernet, or"
            " the board's own USB socket",
        ),
        NamedBoard(
            "spresense", "Sony Spresense", "CXD5602", "1.5 MB", "", "",
            "MicroPython has no port for its CXD5602 (CircuitPython has one, ports/cxd56, without"
            " the modules machine and network, for which programs with uros are written)."
            " micro-ROS's C client speaks to this agent as it is; for Python, take an ESP32-S3, for"
            " which firmware/spresense_* and sprturtlebot* are written, or a Raspberry Pi Pico W",
            ("sony_spresense", "cxd5602"),
        ),
        NamedBoard(
            "arduino_due", "Arduino Due", "ATSAM3X8E", "96 kB", "", "",
            "MicroPython has no port for its SAM3X8E (the port samd is for SAMD21 and SAMD51)."
            " micro-ROS's C client for Arduino speaks to this agent as it is; for Python, take a"
            " Raspberry Pi Pico or an ESP32",
            ("due",),
        ),
        NamedBoard(
            "arduino_uno", "Arduino UNO R3", "ATmega328P", "2 kB", "", "",
            "its 2 kB of RAM are too few: the client of uros alone takes ten times that, and there"
            " is no MicroPython for 8-bit AVR. " + _INSTEAD,
            ("uno", "uno_r3", "atmega328p"),
        ),
        NamedBoard(
            "arduino_mega2560", "Arduino MEGA 2560", "ATmega2560", "8 kB", "", "",
            "its 8 kB of RAM are too few: the client of uros alone takes three times that, and"
            " there is no MicroPython for 8-bit AVR. " + _INSTEAD,
            ("mega2560", "mega", "arduino_mega", "atmega2560"),
        ),
    )
}  # fmt: skip


def find(name: str) -> NamedBoard | None:
    """Find a board by its name or another one in use: ``Pico W`` and ``pico-w`` are ``pico_w``."""
    plain = "_".join(name.lower().replace("-", " ").replace("_", " ").split())
    for board in NAMED.values():
        if plain == board.name or plain in board.other:
            return board
    return None
