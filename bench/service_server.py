"""A service server of rclpy that answers a request with its own fields.

    .venv-ros/bin/python bench/service_server.py DOMAIN SERVICE...

Prints ``ready`` when all services are offered.
"""

from __future__ import annotations

import signal
import sys
from typing import Any

import rclpy
from test_msgs.srv import BasicTypes


def answer(request: Any, response: Any) -> Any:
    for field in request.get_fields_and_field_types():
        setattr(response, field, getattr(request, field))
    return response


def main() -> None:
    rclpy.init(domain_id=int(sys.argv[1]))
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # rclpy's own handler may not end a process
    node = rclpy.create_node("bench_server")
    for name in sys.argv[2:]:
        node.create_service(BasicTypes, name, answer)
    print("ready", flush=True)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
