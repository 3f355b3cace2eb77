"""ROS 2 interfaces: generated message classes, the same on a board and on a host.

``from uros.interfaces.std_msgs.msg import Int32`` and `load` make classes at run time from .msg
files (host); `write_package` writes them as modules for a board. Importing this costs nothing: all
work sits in modules loaded on first use. On a board only `runtime` and `codec` are needed.
"""

import sys

from .errors import InterfaceError

__all__ = ["InterfaceError", "add_folder", "known_hash", "list_types", "load", "write_package"]


def load(name):
    """The class of a type: ``std_msgs/msg/Int32``, ``std_msgs/Int32`` or the DDS name."""
    from .hook import load

    return load(name)


def add_folder(path):
    """Make the definitions under a folder known; returns their type names."""
    from .registry import add_folder

    return add_folder(path)


def list_types():
    """The names of all known types, sorted."""
    from .registry import list_types

    return list_types()


def known_hash(ros_type_name):
    """The RIHS01 hash of a type by name, or None where no definition is at hand."""
    from .typehash import known_hash

    return known_hash(ros_type_name)


def write_package(names, out_dir):
    """Write board modules for the types and all that they nest; returns the paths written."""
    from .package import write_package

    return write_package(names, out_dir)


class _Finder:
    """Last on the import path: hands ``uros.interfaces.<package>`` to `hook`, and nothing else."""

    @staticmethod
    def find_spec(fullname, path=None, target=None):
        if not fullname.startswith(__name__ + "."):
            return None
        from .hook import find_spec

        return find_spec(fullname)


if sys.implementation.name != "micropython":
    sys.meta_path.append(_Finder)
