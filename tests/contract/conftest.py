"""What holds in all these tests."""

import pytest

from uros.middleware.rtps.domain import RtpsDomain


@pytest.fixture(autouse=True)
def deadlines_are_those_of_a_search(monkeypatch):
    """A domain remembers its deadline: that must be what a search finds."""
    remembered = RtpsDomain.next_deadline

    def next_deadline(domain):
        at = remembered(domain)
        assert at == domain._find_deadline()
        return at

    monkeypatch.setattr(RtpsDomain, "next_deadline", next_deadline)
