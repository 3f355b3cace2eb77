"""Choosing a middleware by name."""

import sys

import pytest

from uros.middleware import NAMES, open_middleware
from uros.middleware.base import MiddlewareError


@pytest.mark.parametrize("name", sorted(NAMES))
def test_every_name_opens_a_middleware_that_knows_its_name(name):
    middleware = open_middleware(name)
    assert middleware.name == name
    middleware.close()


def test_an_unknown_name_is_refused_with_those_there_are():
    with pytest.raises(ValueError, match="no middleware 'dss'; there are: dds, memory"):
        open_middleware("dss")


def test_without_cyclone_the_error_says_what_to_install(monkeypatch):
    for name in [name for name in sys.modules if name.startswith("uros.middleware.dds")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "cyclonedds", None)
    with pytest.raises(MiddlewareError, match="needs cyclonedds: python -m pip install cyclonedds"):
        open_middleware("dds")
