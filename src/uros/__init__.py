"""micro-ROS in Python: boards, agent and tools. Importing it costs nothing.

:class:`uros.Node` is loaded when it is first asked for: that of a host, or where there is none,
on a board, that of :mod:`uros.client`.
"""

__version__ = "0.1.0"

TYPE_CHECKING = False
if TYPE_CHECKING:
    from .host.node import Node as Node
else:

    def __getattr__(name):
        if name == "Node":
            try:
                from .host.node import Node
            except ImportError:  # a board
                from .client.node import Node
            return Node
        # MicroPython asks here, and nowhere else, for the qos of "from uros import qos".
        try:
            return __import__("uros." + name, None, None, (name,))
        except ImportError:
            raise AttributeError("uros has no " + name)  # noqa: B904  MicroPython

    try:
        from .moved import install
    except ImportError:  # a board, which has no finders to install
        pass
    else:
        install()
        del install
