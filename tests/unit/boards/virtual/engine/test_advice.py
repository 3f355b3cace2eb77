"""What a program is told that asks a virtual board for what it does not have."""

import pytest

from uros.boards.virtual.engine.advice import advice, miswiring, module_advice
from uros.boards.virtual.hardware.board import VirtualBoard
from uros.boards.virtual.models.catalog import find
from uros.boards.virtual.shims import _ops as ops


def told(name, operation, asked, plugs=()):
    board = VirtualBoard(find(name), plugs=plugs)
    try:
        return advice(board, bytes((operation,)) + asked.encode()).decode()
    finally:
        board.close()


@pytest.mark.parametrize(
    ("name", "operation", "asked", "text"),
    [
        (
            "esp32_publisher", ops.UART_INIT, "1",
            "this virtual board has UART(2) at tx=17, rx=16 (its USB line); --plug esp8266:uart=1"
            " adds a Wi-Fi modem on UART(1)",
        ),
        (
            "esp32_publisher", ops.PIN_MODE, "LED",
            "this virtual board has no pin 'LED'; it has 0 to 5, 12 to 19, 21 to 23, 25 to 27,"
            " 32 to 39, among them 22 (LED), 23 (second LED), 34 (knob)",
        ),
        (
            "esp32_publisher", ops.ADC_READ, "",
            "on this virtual board 34 (knob) has a converter",
        ),
        ("spresense_publisher", ops.ADC_READ, "", "on this virtual board no pin has a converter"),
        (
            "esp32_publisher", ops.I2C_INIT, "0",
            "this virtual board has no I2C bus; 'uros board list' names boards with I2C sensors",
        ),
        (
            "ra6m5_sensor_node", ops.I2C_INIT, "0",
            "this virtual board has I2C(2) with sht3x and mcp9600 and vcnl4010",
        ),
        (
            "ra6m5_sensor_node", ops.WLAN_STATUS, "",
            "this virtual board has no radio; --plug wlan adds one",
        ),
        (
            "spresense_sensors", ops.SPI_INIT, "0",
            "this virtual board has no SPI bus; --plug gs2200:spi=0,ready=PIN,cs=PIN adds a Wi-Fi"
            " modem on SPI(0)",
        ),
    ],
)  # fmt: skip
def test_what_there_is_and_the_plug_that_helps(name, operation, asked, text):
    assert told(name, operation, asked) == text


@pytest.mark.parametrize(
    ("operation", "asked", "plug"),
    [
        (ops.UART_INIT, "1", "esp8266:uart=1"),
        (ops.SPI_INIT, "0", "gs2200:spi=0,ready=PIN,cs=PIN"),
        (ops.WLAN_STATUS, "", "wlan"),
    ],
)
def test_the_plug_that_is_named_can_be_plugged_in(operation, asked, plug):
    assert f"--plug {plug} adds" in told("esp32_publisher", operation, asked)
    board = VirtualBoard(
        find("esp32_publisher"), plugs=[plug.replace("ready=PIN,cs=PIN", "ready=4")]
    )
    try:
        assert board.radio is not None or 1 in board.uarts or 0 in board.spis
    finally:
        board.close()


@pytest.mark.parametrize(
    ("name", "pins", "text"),
    [
        ("esp32_publisher", ("17", "16"), ""),
        ("esp32_publisher", ("", ""), ""),
        (
            "esp32_publisher", ("16", "17"),
            "UART(2) has tx=16, rx=17 (swapped), and this virtual board's line is at tx=17, rx=16:"
            " nothing arrives at either end, as on a real board",
        ),
        (
            "esp32_publisher", ("17", "5"),
            "UART(2) has tx=17, rx=5, and this virtual board's line is at tx=17, rx=16: the board"
            " receives nothing, as on a real board",
        ),
        ("spresense_sensors", ("47", "48"), ""),
        (
            "spresense_sensors", ("", "48"),
            "UART(2) has tx=17, rx=48, and this virtual board's line is at tx=47, rx=48: nothing"
            " that the board sends arrives, as on a real board",
        ),
        ("spresense_publisher_wifi", ("1", "2"), ""),  # a plug fits any pins
    ],
)  # fmt: skip
def test_pins_that_are_not_those_of_the_line(name, pins, text):
    board = VirtualBoard(find(name))
    try:
        board.uarts[2].init(9600, 256, *pins)
        assert miswiring(board, 2) == text
    finally:
        board.close()


def test_a_module_that_is_missing():
    traceback = (
        'Traceback (most recent call last):\n  File "main.py", line 1, in <module>\n'
        "ImportError: no module named 'neopixel.strip'\n"
    )
    text = module_advice(traceback)
    assert "no module 'neopixel.strip': it has camera, machine, network" in text
    assert "neopixel.py beside main.py" in text
    assert module_advice(traceback.replace("ImportError", "ValueError")) == ""
    assert module_advice("") == ""


def test_each_operation_has_a_number_of_its_own():
    states = {"USB_OPEN", "USB_READABLE", "USB_WRITABLE", "USB_DTR", "USB_CLOSED"}
    numbers = [
        number for name, number in vars(ops).items() if name.isupper() and name not in states
    ]
    assert len(numbers) > 50 and len(set(numbers)) == len(numbers)
