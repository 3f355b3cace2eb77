"""The interface of micropython-lib's ``usb-device``, on a virtual board."""

from . import core
from .core import get

__all__ = ["core", "get"]
