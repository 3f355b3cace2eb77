"""Messages larger than a board's memory: their last field is read while they are sent.

::

    image = CompressedImage(format="jpeg")
    publish_stream(publisher, image, length, camera)

No more of the message is held than the window of the reliable stream, and nothing waits: a part is
read when the agent has acknowledged those before it.
"""

from struct import pack_into

from ..wire import ids
from ..wire.errors import EncodeError

try:
    from typing import Any, Iterator

    from ..wire.cdr import Buffer
except ImportError:  # MicroPython
    pass


def publish_stream(publisher: "Any", message: "Any", length: int, source: "Any") -> bool:
    """Publish ``message`` with ``length`` octets of ``source`` as its last field.

    Args:
        publisher: A reliable publisher.
        message: Its last field, a sequence of uint8 (or int8, char, byte), is empty.
        length: Octets to read from ``source``.
        source: An iterator of bytes, or an object with ``readinto(view)``, which fills a memoryview
            from its start on and returns the number of octets written. It is read while the node
            spins, must not wait, and is in use until :func:`streaming` returns False. If it ends
            early or raises, the session ends, because a partly sent message cannot be withdrawn.

    Returns:
        False if there is no connection or another stream is in progress.

    Raises:
        EncodeError: The publisher is best effort.
        ValueError: The message does not end with an empty sequence. Errors of packing are passed
            on.
    """
    if not publisher.flags & ids.QOS_RELIABLE:
        raise EncodeError("%s is best effort: make it reliable to stream" % publisher.name)
    connection = publisher.connection
    if not publisher.created or not connection.ready or streaming(publisher):
        publisher.dropped += 1
        return False
    size = message.cdr_size()
    head = bytearray(12 + size)
    message.pack_into(head, 12, 12)
    if size < 4 or head[size + 8] or head[size + 9] or head[size + 10] or head[size + 11]:
        raise ValueError("%s does not end with an empty sequence" % message._TYPE)
    for i in range(4):
        head[size + 8 + i] = length >> 8 * i & 0xFF
    object_id = publisher.object_id(ids.KIND_DATAWRITER)
    whole = size + 12 + length
    # As for all samples, the length is 0 over 64 kB.
    body_size = whole - 8 if whole - 8 <= 0xFFFF else 0
    pack_into("<BBH", head, 4, ids.WRITE_DATA, ids.FLAG_LITTLE_ENDIAN, body_size)
    pack_into(">HH", head, 8, connection.next_request(), object_id)
    if not hasattr(source, "readinto"):
        source = _Chunks(source)
    publisher.published += 1
    connection.defer(Streamed(connection, head, length, source))
    return True


def streaming(publisher: "Any") -> bool:
    """Return whether a stream is in progress in the publisher's session."""
    for message in publisher.connection.waiting:
        if isinstance(message, Streamed):
            return True
    return False


class Streamed:
    """A message of which only the ``head`` is in memory."""

    def __init__(self, connection: "Any", head: bytearray, length: int, source: "Any") -> None:
        self.connection = connection
        self.head = head
        self.length = length
        self.source = source

    def __len__(self) -> int:
        return len(self.head) + self.length

    def fill(self, part: bytearray, at: int, first: int, stop: int) -> None:
        """Copy the message's octets from ``first`` to ``stop`` into ``part[at:]``."""
        copied = min(stop, len(self.head)) - first
        if copied > 0:
            part[at : at + copied] = memoryview(self.head)[first : first + copied]
            at += copied
            first += copied
        end = at + stop - first
        view = memoryview(part)[:end]
        begun = False
        try:
            while at < end:
                rest = view[at:]
                begun = True
                count = self.source.readinto(rest)
                if not count or count > end - at:
                    raise OSError("it ended early")
                at += count
        except Exception as error:
            if begun:  # octets read from the source cannot be read again
                self.connection.end("a stream broke off: %s" % error)
            # The caller retries after a MemoryError; by then this session has ended.
            raise MemoryError


class _Chunks:
    """Reads from an iterator of bytes."""

    def __init__(self, chunks: "Any") -> None:
        self._chunks: "Iterator[Buffer]" = iter(chunks)
        self._chunk: "Buffer" = b""
        self._at = 0

    def readinto(self, view: memoryview) -> int:
        while self._at == len(self._chunk):
            try:
                self._chunk = next(self._chunks)
            except StopIteration:
                return 0
            self._at = 0
        count = min(len(view), len(self._chunk) - self._at)
        view[:count] = memoryview(self._chunk)[self._at : self._at + count]
        self._at += count
        return count
