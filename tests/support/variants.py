"""Variants of tests: which of them `make test` runs, and which `make test-full` alone."""

import pytest


def slow_except(values, *daily):
    """Return all values as parameters, those marked ``slow`` that are not in ``daily``."""
    return [
        value if value in daily else pytest.param(value, marks=pytest.mark.slow) for value in values
    ]
