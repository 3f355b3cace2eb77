"""The virtual boards by name."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from ..hardware.board import VirtualBoard


class BoardError(ValueError):
    """There is no board of this name; the text lists the names."""


@dataclass(frozen=True)
class BoardSpec:
    """A virtual board and the program that it runs.

    Attributes:
        name: Its name, which is also that of its folder in firmware/.
        text: What its program does, in a few words.
        mcu: The board and its microcontroller.
        hardware: The module of this package that wires it.
        ports: The MicroPython ports that its program is written for.
        plugs: The peripherals that are attached from the start (see
            `uros.boards.virtual.hardware.peripherals`).
        agent: The address at which its program expects the agent in its network, "" on a serial
            line.
    """

    name: str
    text: str
    mcu: str
    hardware: str
    ports: tuple[str, ...]
    plugs: tuple[str, ...] = ()
    agent: str = ""

    @property
    def firmware(self) -> str:
        """The folder of its program in firmware/, which has the board's name."""
        return self.name

    def wire(self, board: VirtualBoard) -> None:
        """Add the parts, pins and buses of its hardware to a board."""
        importlib.import_module(f"{__package__}.{self.hardware}").wire(board)


_RA6M5: Final = ("EK-RA6M5 (R7FA6M5BH3CFC)", "ra6m5", ("renesas-ra",))
_ESP32: Final = ("ESP32-DevKitC (ESP32)", "esp32", ("esp32",))
# A Spresense has no MicroPython port: this board takes its place.
_SPRESENSE: Final = ("ESP32-S3-DevKitC-1 (for a Spresense)", "spresense", ("esp32",))
_ROVER: Final = (_SPRESENSE[0], "sprturtlebot", ("esp32",))
_MODEMS: Final = ("gs2200:spi=1,ready=14,cs=21", "esp8266:uart=2")
_AGENT: Final = "192.168.1.10:8888"

_LIST: Final = (
    BoardSpec("ra6m5_sensor_node", "three I2C sensors as a micro-ROS node over USB", *_RA6M5),
    BoardSpec(
        "ra6m5_usb_text", "the same sensors as a line of text a second over USB, without ROS",
        *_RA6M5,
    ),
    BoardSpec("spresense_publisher", "a number that counts up, ten a second", *_SPRESENSE),
    BoardSpec(
        "spresense_publisher_wifi", "the same over a Wi-Fi modem, GS2200 or ESP8266",
        *_SPRESENSE, _MODEMS, _AGENT,
    ),
    BoardSpec("spresense_subscriber", "an LED that a number switches", *_SPRESENSE),
    BoardSpec("spresense_camera", "a picture a second", *_SPRESENSE),
    BoardSpec("spresense_service_server", "a service that switches an LED", *_SPRESENSE),
    BoardSpec("spresense_service_client", "calls a service every two seconds", *_SPRESENSE),
    BoardSpec(
        "spresense_sensors", "ten kinds of sensor messages",
        _SPRESENSE[0], "spresense_sensors", ("esp32",),
    ),
    BoardSpec(
        "sprturtlebot", "a rover with a camera, driven by cmd_vel, over Wi-Fi",
        *_ROVER, ("gs2200:spi=1,ready=14,cs=21",), _AGENT,
    ),
    BoardSpec(
        "sprturtlebot_pid", "the rover's wheels, tuned by a visualiser over Wi-Fi",
        *_ROVER, ("wlan",), "192.168.1.10:10001",
    ),
    BoardSpec("esp32_publisher", "a number that counts up, once a second", *_ESP32),
    BoardSpec("esp32_publisher_reconnect", "the same, and it finds its agent again", *_ESP32),
    BoardSpec("esp32_subscriber", "an LED whose brightness comes from ROS", *_ESP32),
    BoardSpec("esp32_subscriber_reconnect", "the same, and it finds its agent again", *_ESP32),
    BoardSpec(
        "esp32_button_led", "a button switches an LED, whose brightness comes from ROS", *_ESP32
    ),
    BoardSpec(
        "esp32_wifi_publisher", "a number that counts up, over an access point of the board's own",
        *_ESP32, ("wlan",), "10.16.1.2:8888",
    ),
    BoardSpec("esp32_tf_clock", "a transform, and the ROS time on the board", *_ESP32),
)  # fmt: skip

BOARDS: Final = {spec.name: spec for spec in _LIST}


def find(name: str) -> BoardSpec:
    """Return the board of this name.

    Raises:
        BoardError: There is none.
    """
    if name not in BOARDS:
        raise BoardError(f"there is no board {name}; there are {', '.join(BOARDS)}")
    return BOARDS[name]
