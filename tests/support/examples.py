"""The number of examples of a property test, by the profile of the run.

``quick`` is for ``make quick``, ``daily`` for ``make test``, ``deep`` for ``make test-full``;
``tests/conftest.py`` defines the profiles.
"""

from hypothesis import settings

SCALE = {"quick": 0.1, "daily": 1, "deep": 3}


def examples(daily: int) -> int:
    """The number of examples, given the number for ``make test``; at least 5."""
    return max(5, int(daily * SCALE[settings.get_current_profile_name()]))
