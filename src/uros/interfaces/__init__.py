"""ROS 2 interfaces: generated message classes, the same on a board and on a host.

``from uros.interfaces.std_msgs.msg import Int32`` and `load` make classes at run time from .msg
files (host); `write_package` writes them as modules for a board. Importing this package is cheap:
the modules that do the work are loaded on first use. A board needs only `runtime` and `codec`, with
`compact` for classes generated for boards, and `dynamic` with `table` for types made at run time.

On boards and hosts:

===========  =====================================================================================
``runtime``  Base class of messages; checks, strings and sequences.
``codec``    Messages with the CDR encapsulation header, as DDS and bag files carry them.
``compact``  Helpers of classes generated for boards, which save memory and garbage.
``dynamic``  Types from the text of their definitions, at run time.
``table``    Messages that are packed and unpacked by a table of their fields.
``checked``  Messages that reject assignments to unknown fields, for virtual boards.
``errors``   Errors of definitions and of serialized messages.
===========  =====================================================================================

On hosts alone:

==============  ==================================================================================
``parse``       Parser of .msg, .srv and .action definitions.
``registry``    Search path of definitions, by type name.
``distro``      Definitions that differ between ROS 2 distributions.
``typehash``    RIHS01 type hashes.
``layout``      Sizes, alignment and struct codes of fields.
``walk``        Traversal of a message's fields, common to the emitters.
``emit``        Emitter of codec methods for hosts, made for speed.
``board_walk``  Traversal of a message's fields, common to both emitters for boards.
``emit_board``  Emitter of packing methods for boards, made for small code.
``emit_load``   Emitter of loading methods for boards.
``generate``    Source of a module from a definition.
``stubs``       Type stubs of interface packages, for editors.
``package``     Board modules of a set of types, written to a folder.
``hook``        `load`, and the import hook for ``uros.interfaces.<package>``.
==============  ==================================================================================
"""

import sys

from .errors import InterfaceError

__all__ = ["InterfaceError", "add_folder", "known_hash", "list_types", "load", "write_package"]


def load(name):
    """Return the class of a type: ``std_msgs/msg/Int32``, ``std_msgs/Int32`` or the DDS name."""
    from .hook import load

    return load(name)


def add_folder(path):
    """Make the definitions under a folder known; returns their type names."""
    from .registry import add_folder

    return add_folder(path)


def list_types():
    """Return the names of all known types, sorted."""
    from .registry import list_types

    return list_types()


def known_hash(ros_type_name):
    """Return the RIHS01 hash of a type by name, or None if its definition is unknown."""
    from .typehash import known_hash

    return known_hash(ros_type_name)


def write_package(names, out_dir):
    """Write board modules for the types and their nested types; returns the paths written."""
    from .package import write_package

    return write_package(names, out_dir)


class _Finder:
    """Last import finder: passes ``uros.interfaces.<package>`` to `hook` and ignores the rest."""

    @staticmethod
    def find_spec(fullname, path=None, target=None):
        # A hook that is not there, as after uros was removed, must not be looked for by itself.
        if not fullname.startswith(__name__ + ".") or fullname == __name__ + ".hook":
            return None
        from .hook import find_spec

        return find_spec(fullname)


if sys.implementation.name != "micropython":
    sys.meta_path.append(_Finder)
