"""The number of examples of a property test, by the profile of the run.

``quick`` is for ``make quick``, ``daily`` for ``make test``, ``deep`` for ``make test-full``;
``tests/conftest.py`` defines the profiles.
"""

from hypothesis import settings

SCALE = {"quick": 0.1, "daily": 0.3, "deep": 3}


def examples(number: int) -> int:
    """The number of examples in this run, for a test that has ``number`` at scale 1; at least 5."""
    return max(5, int(number * SCALE[settings.get_current_profile_name()]))
