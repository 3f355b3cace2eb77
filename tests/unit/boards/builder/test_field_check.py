"""Tests of the field check: misspelt fields are found at build time, without false alarms."""

import pytest
from support.paths import ROOT
from support.variants import slow_except

from uros.boards.builder.errors import FieldError
from uros.boards.builder.field_check import check_fields
from uros.boards.builder.file_system import build
from uros.boards.builder.resolver import Resolver

CLONE = ROOT


def faults(tmp_path, text, **modules):
    """Return the field faults of a program, without the folder."""
    program = tmp_path / "program"
    program.mkdir(exist_ok=True)
    (program / "main.py").write_text(text)
    for name, module_text in modules.items():
        (program / f"{name}.py").write_text(module_text)
    modules = Resolver(program, set(), terse=True, checked=False).run(())
    return [fault.replace(f"{program}/", "") for fault in check_fields(modules.values())]


IMPORTS = """\
from example_interfaces.action import Fibonacci
from example_interfaces.srv import AddTwoInts
from geometry_msgs.msg import TransformStamped, Twist
from sensor_msgs.msg import BatteryState, Imu, Temperature
from std_msgs.msg import Int32, String, UInt8
from tf2_msgs.msg import TFMessage
"""
BATTERY = "sensor_msgs/msg/BatteryState has no field volts; did you mean voltage?"


@pytest.mark.parametrize(
    "body, expected",
    [
        ("m = BatteryState()\nm.volts = 7.4", BATTERY),
        ("m = BatteryState()\nm.volts += 7.4", BATTERY),
        ("m = None\nm = BatteryState()\nm.volts = 1.0", BATTERY),
        ("BatteryState().volts = 1.0", BATTERY),
        ("m = BatteryState(volts=7.4)", BATTERY),
        ("a, m = 1, BatteryState()\nm.volts = 1.0", BATTERY),
        ("a = m = BatteryState()\na.volts = 1.0", BATTERY),
        ("m = [BatteryState() for _ in range(3)]\nm[0].volts = 1.0", BATTERY),
        ("for m in (BatteryState(), BatteryState()):\n    m.volts = 1.0", BATTERY),
        ("m = BatteryState()\ndef f():\n    m.volts = 1.0", BATTERY),
        ("m = None\ndef f():\n    global m\n    m = BatteryState()\ndef g():\n    m.volts = 1.0",
         BATTERY),
        ("def make():\n    m = BatteryState()\n    return m\nmake().volts = 1.0", BATTERY),
        ("def f(m: BatteryState):\n    m.volts = 1.0", BATTERY),
        ("def f(m: 'BatteryState | None'):\n    m.volts = 1.0", BATTERY),
        ("def f(m):\n    print(m.volts)\ndef go(node):\n"
         "    node.create_subscription(BatteryState, 'x', f)", BATTERY),
        ("def go(node):\n    node.create_subscription(BatteryState, 'x', lambda m: print(m.volts))",
         BATTERY),
        ("def go(node):\n    node.create_subscription(\n        msg_type=BatteryState, topic='x',"
         " callback=lambda m: print(m.volts))", BATTERY),
        ("class A:\n    def __init__(self, node):\n        node.create_subscription(BatteryState,"
         " 'x', self.on)\n    def on(self, m: 'Any'):\n        print(m.volts)", BATTERY),
        ("class A:\n    def __init__(self):\n        self.m = BatteryState()\n    def f(self):\n"
         "        self.m.volts = 1.0", BATTERY),
        ("class A:\n    m = BatteryState()\n    def f(self):\n        self.m.volts = 1.0", BATTERY),
        ("class A:\n    def __init__(self):\n        self.m = BatteryState()\n"
         "class B(A):\n    def f(self):\n        m = self.m\n        m.volts = 1.0", BATTERY),
        ("class A:\n    def __init__(self):\n        self.m = BatteryState()\na = A()\n"
         "a.m.volts = 1.0", BATTERY),
        ("def fill(m):\n    m.volts = 1.0\nfill(BatteryState())", BATTERY),
        ("m = Imu()\nm.header.stmp.sec = 1",
         "std_msgs/msg/Header has no field stmp; did you mean stamp?"),
        ("m = Imu()\nm.header.stamp.sek = 1",
         "builtin_interfaces/msg/Time has no field sek; did you mean sec?"),
        ("m = Twist()\nm.x = 1.0",
         "geometry_msgs/msg/Twist has no field x; did you mean linear.x or angular.x?"),
        ("m = TFMessage()\nfor item in m.transforms:\n    print(item.transfrom)",
         "geometry_msgs/msg/TransformStamped has no field transfrom; did you mean transform?"),
        ("def on(request, response):\n    response.summ = request.a\n    return response\n"
         "def go(node):\n    node.create_service(AddTwoInts, 'x', on)",
         "example_interfaces/srv/AddTwoInts_Response has no field summ; did you mean sum?"),
        ("def on(request, response):\n    response.sum = request.aa\n    return response\n"
         "def go(node):\n    node.create_service(AddTwoInts, 'x', on)",
         "example_interfaces/srv/AddTwoInts_Request has no field aa; did you mean a?"),
        ("r = AddTwoInts.Request()\nr.c = 1",
         "example_interfaces/srv/AddTwoInts_Request has no field c; it has a, b"),
        ("r = AddTwoInts.Request(c=1)",
         "example_interfaces/srv/AddTwoInts_Request has no field c; it has a, b"),
        ("class A:\n    def __init__(self, node):\n        self.c = node.create_client(AddTwoInts,"
         " 'x')\n    def go(self):\n        self.c.call_async(AddTwoInts.Request())"
         ".add_done_callback(self.done)\n    def done(self, future):\n"
         "        print(future.result().summ)",
         "example_interfaces/srv/AddTwoInts_Response has no field summ; did you mean sum?"),
        ("g = Fibonacci.Goal()\ng.ordr = 1",
         "example_interfaces/action/Fibonacci_Goal has no field ordr; did you mean order?"),
        ("r = Fibonacci.Result()\nr.sequences = 1",
         "example_interfaces/action/Fibonacci_Result has no field sequences; did you mean"
         " sequence?"),
        ("import sensor_msgs.msg\nm = sensor_msgs.msg.BatteryState()\nm.volts = 1.0", BATTERY),
        ("import sensor_msgs.msg as s\nm = s.BatteryState()\nm.volts = 1.0", BATTERY),
        ("from sensor_msgs import msg\nm = msg.BatteryState()\nm.volts = 1.0", BATTERY),
        ("m = UInt8()\nm.data = 300",
         "std_msgs/msg/UInt8.data: 300 is out of range 0 to 255"),
        ("m = UInt8(data=-1)", "std_msgs/msg/UInt8.data: -1 is out of range 0 to 255"),
        ("m = Int32()\nm.data = 1.5", "std_msgs/msg/Int32.data: expected int32, got float"),
        ("m = String()\nm.data = 5", "std_msgs/msg/String.data: expected string, got int"),
        ("m = Temperature()\nm.temperature = '20'",
         "sensor_msgs/msg/Temperature.temperature: expected double, got str"),
    ],
)  # fmt: skip
def test_each_unknown_field_and_unfit_value_is_reported(tmp_path, body, expected):
    lines = faults(tmp_path, IMPORTS + body + "\n")
    assert [line.partition(": ")[2] for line in lines] == [expected]
    assert lines[0].startswith("main.py:")


def test_every_fault_is_reported_with_its_line(tmp_path):
    text = "from std_msgs.msg import Int32\nm = Int32()\nm.dat = 1\n\nm.date = 2\n"
    hint = "did you mean data?"
    assert faults(tmp_path, text) == [
        f"main.py:3: std_msgs/msg/Int32 has no field dat; {hint}",
        f"main.py:5: std_msgs/msg/Int32 has no field date; {hint}",
    ]


def test_a_message_from_another_module_is_checked(tmp_path):
    other = "from std_msgs.msg import Int32\ncount = Int32()\n"
    lines = faults(tmp_path, "from counts import count\ncount.dat = 1\n", counts=other)
    assert lines == ["main.py:2: std_msgs/msg/Int32 has no field dat; did you mean data?"]


@pytest.mark.parametrize(
    "body",
    [
        # Other objects, and names that may be bound to another type.
        "class A:\n    pass\na = A()\na.volts = 1",
        "def f(m):\n    m.volts = 1",
        "m = BatteryState()\nm = object()\nm.volts = 1",
        "def f(x):\n    m = BatteryState() if x else Imu()\n    m.volts = 1",
        "class BatteryState:\n    pass\nm = BatteryState()\nm.volts = 1",
        "class Mine(BatteryState):\n    volts = 0\nm = Mine()\nm.volts = 1",
        "m = BatteryState()\ndef f(m):\n    m.volts = 1",
        "m = BatteryState()\ndef f():\n    m = object()\n    m.volts = 1",
        "m = BatteryState()\nx = [m.volts for m in (object(),)]",
        "m = BatteryState()\nfor m in unknown():\n    m.volts = 1",
        "m = BatteryState()\nwith open('x') as m:\n    m.volts = 1",
        "m = BatteryState()\ntry:\n    pass\nexcept Exception as m:\n    m.volts = 1",
        "m = BatteryState()\ndef f():\n    global m\n    m = object()\nm.volts = 1",
        "m = BatteryState()\nm.header.stamp.high = 1\nm.header.stamp.low = 1",
        # Attributes that other code of the program may set.
        "class A:\n    def __init__(self):\n        self.m = BatteryState()\n    def f(self):\n"
        "        self.m.volts = 1\ndef g(a):\n    a.m = object()",
        "class A:\n    def __init__(self):\n        self.m = BatteryState()\n    def f(self):\n"
        "        self.m.volts = 1\nclass B(A):\n    def g(self):\n        self.m = object()",
        "class A:\n    def __init__(self, n):\n        self.m = BatteryState()\n"
        "        setattr(self, n, 1)\n    def f(self):\n        self.m.volts = 1",
        # Functions that are called with values of several types.
        "def f(m):\n    m.volts = 1\nf(BatteryState())\nf(object())",
        "def f(m):\n    m.header.stamp.sec = 1\n    print(m.orientation)\nf(BatteryState())\n"
        "f(Imu())",
        "def on(m):\n    print(m.volts)\ntable = {'a': on}\ndef go(node):\n"
        "    node.create_subscription(BatteryState, 'x', on)",
        "def wrap(f):\n    return f\n@wrap\ndef on(m):\n    print(m.volts)\ndef go(node):\n"
        "    node.create_subscription(BatteryState, 'x', on)",
        "class A:\n    def on(self, m):\n        print(m.volts)\n    def go(self, node):\n"
        "        node.create_subscription(BatteryState, 'x', getattr(self, 'on'))\n"
        "        node.create_subscription(BatteryState, 'x', self.on)",
        # Attributes that the program checks for first.
        "m = BatteryState()\nif hasattr(m, 'volts'):\n    m.volts = 1",
        "m = BatteryState()\ntry:\n    print(m.volts)\nexcept AttributeError:\n    pass",
        # Fields, constants, methods.
        "m = BatteryState()\nprint(m.POWER_SUPPLY_STATUS_FULL, m.cdr_size(), m.voltage)",
        "print(BatteryState.POWER_SUPPLY_STATUS_FULL, BatteryState.get_fields_and_field_types())",
        "m = Imu()\nm.orientation_covariance[0] = 1.0\nm.orientation.w = 1.0",
        "m = UInt8()\nm.data = 255\nm = UInt8(data=0)\nt = Temperature(temperature=20)",
        "m = TFMessage()\nm.transforms.append(TransformStamped())",
        "m = Twist(**{'linear': None})",
        "x = m = Int32()\nm.data += 1\ndel m",
        "async def make():\n    return BatteryState()\nmake().volts = 1",
        "def make():\n    yield BatteryState()\nmake().volts = 1",
        "m = BatteryState()\nm = m.header\nm.volts = 1",
        "def f(n):\n    return f(n - 1)\nf(3).volts = 1",
        "class A:\n    def __init__(self, a):\n        self.a = a.a\n    def f(self):\n"
        "        self.a.volts = 1",
    ],
)  # fmt: skip
def test_an_object_of_uncertain_type_is_not_checked(tmp_path, body):
    assert faults(tmp_path, IMPORTS + body + "\n") == []


def test_a_build_with_field_faults_is_refused_and_names_each(tmp_path):
    program = tmp_path / "program"
    program.mkdir()
    (program / "main.py").write_text(IMPORTS + "Int32().date = 1\nString(text='')\n")
    with pytest.raises(FieldError) as caught:
        build(program, tmp_path / "out")
    assert str(caught.value).splitlines() == [
        f"{program}/main.py:7: std_msgs/msg/Int32 has no field date; did you mean data?",
        f"{program}/main.py:8: std_msgs/msg/String has no field text; it has data",
    ]
    assert not (tmp_path / "out").exists()


PROGRAMS = sorted(file.parent for file in (CLONE / "firmware").glob("*/main.py"))


@pytest.mark.parametrize(
    "program", slow_except(PROGRAMS, *PROGRAMS[::10]), ids=lambda folder: folder.name
)
def test_the_firmware_programs_have_no_field_faults(tmp_path, program):
    build(program, tmp_path / "out")
