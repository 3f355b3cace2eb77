"""The boards that there are to buy, and what is said of those that cannot run uros."""

import pytest
from support.paths import ROOT

from uros.boards.deploy.known_boards import NAMED, PLATFORMS, find
from uros.boards.virtual.models.catalog import BOARDS

PAGE = ROOT / "docs" / "ports.md"


@pytest.mark.parametrize(
    ("said", "name"),
    [
        ("pico_w", "pico_w"), ("Pico W", "pico_w"), ("raspberry-pi-pico", "pico"),
        ("Arduino UNO", "arduino_uno"), ("uno", "arduino_uno"), ("MEGA2560", "arduino_mega2560"),
        ("Sony Spresense", "spresense"), ("due", "arduino_due"), ("stm32", "olimex_e407"),
    ],
)  # fmt: skip
def test_boards_are_found_by_what_people_call_them(said: str, name: str) -> None:
    found = find(said)
    assert found is not None and found.name == name


def test_an_unknown_board_is_none() -> None:
    assert find("commodore 64") is None and find("") is None


def test_no_name_means_two_boards() -> None:
    names = [name for it in NAMED.values() for name in (it.name, *it.other)]
    assert len(names) == len(set(names))


def test_every_port_is_one_that_a_board_can_say_that_it_has() -> None:
    ports = {it.port for it in NAMED.values() if it.port}
    assert ports == set(PLATFORMS.values())
    assert all(it.image for it in NAMED.values() if it.port)
    virtual = {port for it in BOARDS.values() for port in it.ports}
    assert virtual <= ports


def test_the_page_of_ports_has_every_board_and_every_port() -> None:
    text = PAGE.read_text("utf-8")
    for it in NAMED.values():
        assert f"`{it.name}`" in text and it.title.split(",")[0] in text
        if it.port:
            assert f"`{it.image}`" in text
    for port in PLATFORMS.values():
        assert f"## {port}" in text
