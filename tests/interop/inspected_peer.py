"""peer.py with nodes that tools look into: parameters of every type, a life cycle, a deaf node."""

import rclpy
from board_peer import Camera, plain
from peer import Peer
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter, get_parameter_value, parameter_dict_from_yaml_file
from rclpy.serialization import serialize_message

DECLARED = {
    "bool": True,
    "int": -4,
    "double": 0.5,
    "text": "grün\tline\nend\x1b[2J \u202e",
    "digits": "0123",
    "octets": [b"\x00", b"\xff"],
    "arm.bools": [True, False],
    "arm.ints": [1, -(2**63)],
    "arm.left.doubles": [0.25, -1e300, float("inf"), float("nan")],
    "arm.left.texts": ["a", "", "no", "1.5", "☃"],
}


class InspectedPeer(Peer):
    def __init__(self):
        super().__init__()
        self.tuned = rclpy.create_node(
            "tuned", namespace="/lab", start_parameter_services=True,
            enable_rosout=False,
        )  # fmt: skip
        for name, value in DECLARED.items():
            self.tuned.declare_parameter(name, value)
        self.tuned.declare_parameter(
            "speed", 1.0,
            ParameterDescriptor(
                description="speed in m/s", additional_constraints="only \x1b[31mgood ones",
                floating_point_range=[
                    FloatingPointRange(from_value=0.0, to_value=2.0, step=0.5)
                ],
            ),
        )  # fmt: skip
        self.tuned.declare_parameter(
            "count", 3,
            ParameterDescriptor(integer_range=[IntegerRange(from_value=-1, to_value=9, step=2)]),
        )  # fmt: skip
        self.tuned.declare_parameter("fixed", 1, ParameterDescriptor(read_only=True))
        self.declare_any()
        self.tuned.add_on_set_parameters_callback(self.check)
        self.executor.add_node(self.tuned)
        self.lens = Camera("lens", namespace="/lab")
        self.executor.add_node(self.lens)
        self.dull = Camera("dull", namespace="/lab")  # nobody spins these two
        self.deaf = rclpy.create_node("deaf", namespace="/lab")

    def declare_any(self):
        self.tuned.declare_parameter("any", 1, ParameterDescriptor(dynamic_typing=True))

    def check(self, parameters):
        for parameter in parameters:
            if parameter.value == "forbidden":
                return SetParametersResult(successful=False, reason="forbidden \x1b[2J is refused")
        return SetParametersResult(successful=True)

    def do_values(self, seconds=15):
        """Return type and value of each parameter of the node ``/lab/tuned``."""
        return {
            "values": {
                name: described(parameter)
                for name, parameter in self.tuned.get_parameters_by_prefix("").items()
            }
        }

    def do_reset(self, seconds=15):
        """Give the parameters of ``/lab/tuned`` their declared values."""
        if not self.tuned.has_parameter("any"):
            self.declare_any()
        values = {**DECLARED, "speed": 1.0, "count": 3, "any": 1}
        self.tuned.set_parameters([Parameter(name, value=value) for name, value in values.items()])
        return {}

    def do_typed(self, texts, seconds=15):
        """Return the types and values for which rclpy takes texts; None where it raises."""
        typed = []
        for text in texts:
            try:
                found = get_parameter_value(text)
                value = getattr(found, Parameter.Type(found.type).name.lower() + "_value")
                serialize_message(found)  # raises for a date or a dict in place of a string
                typed.append([found.type, plain(value)])
            except Exception:
                typed.append(None)
        return {"typed": typed}

    def do_file(self, path, node, seconds=15):
        """Return what rclpy's reader of parameter files finds for a node."""
        found = parameter_dict_from_yaml_file(path, True, [node])
        return {"found": {n: described(Parameter.from_parameter_msg(p)) for n, p in found.items()}}

    def do_started(self, path, name, namespace, seconds=15):
        """Start a node with a parameter file; return its parameters, as rcl has read them."""
        node = rclpy.create_node(
            name, namespace=namespace, cli_args=["--ros-args", "--params-file", path],
            automatically_declare_parameters_from_overrides=True,
        )  # fmt: skip
        found = node.get_parameters_by_prefix("")
        node.destroy_node()
        return {"found": {name: described(parameter) for name, parameter in found.items()}}

    def do_outcome(self, seconds=15, **outcomes):
        """Set the results of the callbacks of the lifecycle node ``/lab/lens``."""
        self.lens.outcomes = {
            key: TransitionCallbackReturn.__members__[value] for key, value in outcomes.items()
        }
        return {}


def described(parameter):
    """Return type and value of a Parameter, as JSON has them; floats as text, for nan and inf."""
    value = plain(parameter.value)
    if parameter.type_ in (Parameter.Type.DOUBLE, Parameter.Type.DOUBLE_ARRAY):
        value = str(value)
    return [parameter.type_.value, value]


if __name__ == "__main__":
    rclpy.init()
    try:
        InspectedPeer().run()
    finally:
        rclpy.try_shutdown()
