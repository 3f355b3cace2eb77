"""``python -m uros``: the same as the ``uros`` command."""

from .tools.cli import main

raise SystemExit(main())
