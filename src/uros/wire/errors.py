"""Errors of encoding and decoding; the class says which peer is at fault.

::

    WireError
     ├── DecodeError      the peer's bytes break the protocol
     │    └── LimitError  they ask for more than a named limit allows
     └── EncodeError      our own values do not fit the protocol

Decoding bytes from outside raises nothing but :class:`DecodeError`.
"""


class WireError(ValueError):
    """Base of every error of this package."""


class DecodeError(WireError):
    """The peer's bytes are truncated or malformed."""


class LimitError(DecodeError):
    """The peer's bytes announce more than a named limit allows."""


class EncodeError(WireError):
    """A value does not fit its field, or the message does not fit its buffer."""
