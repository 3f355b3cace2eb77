"""Announcements of endpoints (SEDP, RTPS 8.5.4): reliable builtin topics of writers and readers."""

from __future__ import annotations

from . import ids, parameters
from .builtin import BuiltinEndpoints
from .local import LocalReader, LocalWriter
from .parameters import EndpointData
from .reader import Sample


def announce(
    endpoint: LocalWriter | LocalReader, topic: BuiltinEndpoints, now: float, wall_ns: int
) -> None:
    """Announce one of our endpoints on the builtin topic of its kind."""
    topic.writer.write(parameters.write_endpoint(endpoint.data), wall_ns, now)
    endpoint.announced = topic.writer.state.last


def withdraw(
    endpoint: LocalWriter | LocalReader, topic: BuiltinEndpoints, now: float, wall_ns: int
) -> None:
    """Announce that one of our endpoints is deleted."""
    announcer, guid = topic.writer, endpoint.data.guid
    # A late participant needs neither the announcement nor the farewell.
    announcer.state.remove(endpoint.announced)
    announcer.write(
        parameters.write_key(guid), wall_ns, now, parameters.write_farewell_qos(guid), is_key=True
    )
    announcer.state.expire(announcer.state.last)


def read_announcement(sample: Sample, is_writer: bool) -> EndpointData | bytes | None:
    """Read a sample of SEDP.

    Args:
        sample: The sample.
        is_writer: Whether it comes from the topic of writers.

    Returns:
        The endpoint that it announces; or the GUID of one that is deleted; or None where it says
        nothing, or speaks for another participant than its own.

    Raises:
        MalformedError: It is not valid.
    """
    found: EndpointData | bytes
    if sample.payload is None or sample.is_key:
        qos = sample.inline_qos
        if qos is None or not qos.status:
            return None
        found = guid = (
            qos.key_hash if sample.payload is None else parameters.read_key(sample.payload)
        )
    else:
        found = parameters.read_endpoint(sample.payload, is_writer)
        guid = found.guid
    return found if guid.startswith(sample.writer[: ids.PREFIX_SIZE]) else None
