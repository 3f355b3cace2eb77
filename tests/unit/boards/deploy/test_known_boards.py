"""Tests of the table of boards on the market, and of its page."""

import pytest
from support.paths import ROOT

from uros.boards.deploy.known_boards import NAMED, PLATFORMS, find
from uros.boards.virtual.models.catalog import BOARDS

PAGE = ROOT / "docs" / "ports.md"


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("pico_w", "pico_w"), ("Pico W", "pico_w"), ("raspberry-pi-pico", "pico"),
        ("Arduino UNO", "arduino_uno"), ("uno", "arduino_uno"), ("MEGA2560", "arduino_mega2560"),
        ("Sony Spresense", "spresense"), ("due", "arduino_due"), ("stm32", "olimex_e407"),
    ],
)  # fmt: skip
def test_a_board_is_found_by_each_of_its_names(text: str, name: str) -> None:
    board = find(text)
    assert board is not None and board.name == name


def test_an_unknown_board_is_none() -> None:
    assert find("commodore 64") is None and find("") is None


def test_no_name_means_two_boards() -> None:
    names = [name for board in NAMED.values() for name in (board.name, *board.other)]
    assert len(names) == len(set(names))


def test_every_port_has_a_platform_name_and_an_image() -> None:
    ports = {board.port for board in NAMED.values() if board.port}
    assert ports == set(PLATFORMS.values())
    assert all(board.image for board in NAMED.values() if board.port)
    virtual = {port for board in BOARDS.values() for port in board.ports}
    assert virtual <= ports


def test_the_page_of_ports_has_every_board_and_every_port() -> None:
    text = PAGE.read_text("utf-8")
    for board in NAMED.values():
        assert f"`{board.name}`" in text and board.title.split(",")[0] in text
        if board.port:
            assert f"`{board.image}`" in text
    for port in PLATFORMS.values():
        assert f"## {port}" in text
