"""Entry points of the commands, and ``python -m uros``.

They import nothing before Ctrl-C is handled: a command that is interrupted while its modules load
ends without a traceback.
"""

from __future__ import annotations

_INTERRUPTED = 130


def main() -> int:
    """Run ``uros``; return the exit status."""
    return _run("main")


def agent_main() -> int:
    """Run ``uros agent`` as ``MicroXRCEAgent`` or ``micro_ros_agent``; return the exit status."""
    return _run("agent_main")


def _run(name: str) -> int:
    try:
        from .tools import cli

        status: int = getattr(cli, name)()
        return status
    except KeyboardInterrupt:
        return _INTERRUPTED


if __name__ == "__main__":
    raise SystemExit(main())
