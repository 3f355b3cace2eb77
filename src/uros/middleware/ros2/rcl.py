"""rclpy below its Node class, and its errors as MiddlewareErrors.

The classes of ``rclpy.impl.implementation_singleton`` are the same from Humble to Kilted, but for
one argument of Node's. An entity that is in a wait set, or inside a call, must not be destroyed:
``with entity`` holds it, and ``destroy_when_not_in_use`` waits for that.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any, Final

from ...qos import QoSProfile
from ..base import Bytes, MiddlewareError
from . import profiles

_CORE: Final = "rclpy.impl.implementation_singleton"
_CHOICES: Final = ("RMW_IMPLEMENTATION", "RCL_ASSERT_RMW_ID_MATCHES")
_REMEDY: Final = "install that RMW (ros-<distro>-rmw-…), or unset RMW_IMPLEMENTATION"
_WRONG_RMW: Final = 102  # rcl's exit status
_PATIENCE: Final = 20.0


def load() -> Any:
    """Return rclpy's classes in C.

    Raises:
        ImportError: There is no rclpy.
        MiddlewareError: rclpy does not work here.
    """
    if _CORE not in sys.modules:
        _try_elsewhere()
    try:
        from rclpy.impl.implementation_singleton import rclpy_implementation

        rclpy_implementation.rclpy_get_rmw_implementation_identifier()
    except ImportError:
        raise
    except Exception as error:
        raise MiddlewareError(f"rclpy does not start ({_line(error)}): {_REMEDY}") from error
    return rclpy_implementation


def _try_elsewhere() -> None:
    """Raises MiddlewareError if rcl would end this process.

    It does so when it is loaded with an RMW that it does not find. An import in another process
    takes a tenth of a second, and is made only if the environment names an RMW.
    """
    if any(map(os.environ.get, _CHOICES)) and find_spec("rclpy") is not None:
        _elsewhere(f"import {_CORE}")


def _elsewhere(code: str) -> None:
    """Run code in another process. Raises MiddlewareError if that ends by a signal or by rcl.

    An exception there is ignored: it will be raised here as well.
    """
    import subprocess

    try:
        status = subprocess.run(
            [sys.executable, "-c", code],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=dict(os.environ, PYTHONPATH=os.pathsep.join(sys.path)),
            timeout=_PATIENCE,
        ).returncode
    except (OSError, subprocess.SubprocessError):
        return
    if status == _WRONG_RMW:
        chosen = [name for name in _CHOICES if os.environ.get(name)]
        settings = ", ".join(f"{name}={os.environ[name]}" for name in chosen)
        raise MiddlewareError(f"rclpy does not start with {settings or 'its RMW'}: {_REMEDY}")
    if status < 0:
        raise MiddlewareError(
            f"rclpy does not start (a process that imports it ends by signal {-status}): {_REMEDY}"
        )


@contextmanager
def refused(about: str) -> Iterator[None]:
    """Turn what rclpy raises in the block into a MiddlewareError that begins with ``about``."""
    try:
        yield
    except MiddlewareError:
        raise
    except Exception as error:  # RCLError, RMWError, ValueError and what conversions raise
        raise MiddlewareError(f"{about}: {_line(error)}") from error


def _line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def open_context(domain: int) -> Any:
    """Return a context of a domain, without signal handlers and without a log of its own.

    Raises:
        MiddlewareError: ROS 2 does not start.
    """
    from rclpy.context import Context

    context = Context()
    with refused(f"ROS 2 does not start in domain {domain}"):
        context.init(args=[], initialize_logging=False, domain_id=domain)
    return context


def create_node(context: Any, namespace: str, name: str) -> Any:
    """Return rclpy's node without parameters, services and a publisher of logs.

    Raises:
        MiddlewareError: rcl refuses it.
    """
    implementation = load()
    options = (name, namespace, context.handle, None, False, False)
    with refused(f"node {namespace.rstrip('/')}/{name}"), context.handle:
        try:
            return implementation.Node(*options)
        except TypeError:  # from Kilted on it takes a profile for the log, which it does not use
            return implementation.Node(*options, profiles.to_rclpy(QoSProfile()))


def read(about: str, cdr: Bytes, kind: Any) -> Any:
    """Return a sample as an object of rclpy's.

    Raises:
        MiddlewareError: It is no such message; the text begins with ``about``.
    """
    from rclpy.serialization import deserialize_message

    with refused(f"{about} does not read as its type"):
        return deserialize_message(bytes(cdr), kind)


def as_bytes(message: Any) -> bytes:
    """Return an object of rclpy's as a sample."""
    from rclpy.serialization import serialize_message

    sample: bytes = serialize_message(message)
    return sample
