"""Pseudo-random numbers for tests that run on CPython and on MicroPython."""


class Chance:
    """A generator of the same numbers on every platform."""

    def __init__(self, seed):
        self.state = (seed * 7919 + 12345) & 0x7FFFFFFF

    def below(self, limit):
        """A number from 0 to ``limit`` - 1."""
        self.state = (self.state * 1103515245 + 12345) & 0x7FFFFFFF
        return (self.state >> 8) % limit

    def hit(self, percent):
        """True with a probability of ``percent``."""
        return self.below(100) < percent
