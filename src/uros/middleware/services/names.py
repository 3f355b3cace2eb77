"""The ROS name and type of a service, from the DDS names of its two topics."""

from __future__ import annotations

from ... import names
from ..base import MiddlewareError, Service
from ..ros_names import TypeName, demangle, message_type


def service_name(service: Service) -> str:
    """Return the ROS name that both topics of a service have.

    Raises:
        MiddlewareError: They are not the topics of one ROS service.
    """
    name = demangle(service.request_topic, "rq", "Request")
    if demangle(service.reply_topic, "rr", "Reply") != name:
        raise MiddlewareError(
            f"{service.request_topic!r} and {service.reply_topic!r} are not of one service"
        )
    return name


def service_type(service: Service) -> TypeName:
    """Return the ROS type that requests and replies of a service belong to.

    Raises:
        MiddlewareError: They are not of one ROS service.
    """
    request, reply = message_type(service.request_type), message_type(service.reply_type)
    name = request.name.removesuffix("_Request")
    if (
        name == request.name
        or reply != request._replace(name=name + "_Response")
        or request.kind == "msg"
    ):
        raise MiddlewareError(
            f"{service.request_type} and {service.reply_type} are not of one ROS service"
        )
    return request._replace(name=name)


def display_name(service: Service) -> str:
    """Return a service's name for the user: its ROS name, or the topic of its requests."""
    return names.service_from_request(service.request_topic) or service.request_topic
