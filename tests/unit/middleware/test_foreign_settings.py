"""Settings of Fast DDS have no effect, and the user is told."""

import logging

import pytest

from uros.middleware import open_middleware

PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
NEWER_PROFILES = "FASTDDS_DEFAULT_PROFILES_FILE"
SERVER = "ROS_DISCOVERY_SERVER"


@pytest.fixture(autouse=True)
def no_settings(monkeypatch):
    for name in (PROFILES, NEWER_PROFILES, SERVER):
        monkeypatch.delenv(name, raising=False)


def warnings(caplog, middleware):
    with caplog.at_level(logging.WARNING, "uros"):
        open_middleware(middleware).close()
    return [record.getMessage() for record in caplog.records]


@pytest.mark.parametrize(
    "middleware", ["auto", pytest.param("dds", marks=pytest.mark.cyclone), "rtps"]
)
@pytest.mark.parametrize(
    ("name", "remedy"),
    [(SERVER, "ROS_STATIC_PEERS"), (PROFILES, "--refs"), (NEWER_PROFILES, "--refs")],
)
def test_a_setting_of_fast_dds_causes_a_warning_with_the_remedy(
    monkeypatch, caplog, middleware, name, remedy
):
    monkeypatch.setenv(name, "10.0.0.1:11811")
    (warning,) = warnings(caplog, middleware)
    assert warning.startswith(f"uros: {name} has no effect: ") and remedy in warning


def test_an_empty_setting_and_one_without_a_network_cause_none(monkeypatch, caplog):
    monkeypatch.setenv(SERVER, " ")
    assert warnings(caplog, "rtps") == []
    monkeypatch.setenv(SERVER, "10.0.0.1:11811")
    assert warnings(caplog, "memory") == []
