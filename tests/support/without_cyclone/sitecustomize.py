"""Hides the package cyclonedds from a Python that starts with this folder in PYTHONPATH."""

import sys
from importlib.machinery import ModuleSpec


class _Hidden:
    """Finds everything but cyclonedds."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        if name.partition(".")[0] == "cyclonedds":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return None


sys.meta_path.insert(0, _Hidden())
