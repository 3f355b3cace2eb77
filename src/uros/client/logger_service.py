"""Services that get and set the levels of a node's loggers."""

from .dynamic_messages import ShapedService

try:
    from typing import Any
except ImportError:  # MicroPython
    pass


class LoggerService:
    """The services ``~/get_logger_levels`` and ``~/set_logger_levels`` of a node.

    They are those of rclpy with ``enable_logger_service``.
    """

    def __init__(self, node: "Any") -> None:
        self._logger = node.get_logger()
        for name, request, response, callback in (
            ("Get", "[s]", "[sI]", self._get),
            ("Set", "[sI]", "[?s]", self._set),
        ):
            service = ShapedService(
                "rcl_interfaces/srv/" + name + "LoggerLevels", request, response
            )
            node.create_service(service, "~/" + name.lower() + "_logger_levels", callback)

    def _get(self, request: "Any", response: "Any") -> "Any":
        levels = self._logger.levels()
        response.values = [[[name, levels.get(name, 0)] for name in request.values[0]]]
        return response

    def _set(self, request: "Any", response: "Any") -> "Any":
        results = []
        for name, level in request.values[0]:
            try:
                self._logger.named(name).set_level(level)
                results.append([True, ""])
            except ValueError as error:
                results.append([False, str(error)])
        response.values = [results]
        return response
