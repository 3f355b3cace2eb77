"""Chance for tests that run on CPython and on MicroPython."""


class Chance:
    """The same numbers on every platform."""

    def __init__(self, seed):
        self.state = (seed * 7919 + 12345) & 0x7FFFFFFF

    def below(self, most):
        self.state = (self.state * 1103515245 + 12345) & 0x7FFFFFFF
        return (self.state >> 8) % most

    def hit(self, percent):
        return self.below(100) < percent
