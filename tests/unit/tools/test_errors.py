"""Suggestions for names that are unknown."""

from uros.tools.errors import did_you_mean


def test_the_words():
    assert did_you_mean("udp", ("udp4", "tcp4", "udp6")) == "; did you mean 'udp4' or 'udp6'?"
    assert did_you_mean("zzz", ("udp4", "udp6")) == ""
