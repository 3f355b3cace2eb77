"""Names, folders, imports, and the written board package."""

import ast
import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

import uros.interfaces
from uros.interfaces import (
    InterfaceError,
    add_folder,
    known_hash,
    list_types,
    load,
    registry,
    write_package,
)
from uros.interfaces.codec import from_cdr, to_cdr
from uros.interfaces.generate import generate

MISSING_ON_BOARD = {"dataclasses", "enum", "typing", "abc", "collections", "__future__", "re"}


@pytest.fixture(autouse=True)
def forget_folders(monkeypatch):
    monkeypatch.setattr(registry, "_added", {})
    yield
    registry._definition.cache_clear()


def write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def test_public_names():
    assert uros.interfaces.__all__ == [
        "InterfaceError",
        "add_folder",
        "known_hash",
        "list_types",
        "load",
        "write_package",
    ]


def test_spellings():
    want = load("std_msgs/msg/Int32")
    assert load("std_msgs/Int32") is want
    assert load("std_msgs::msg::dds_::Int32_") is want
    assert load("std_msgs::msg::Int32") is want
    trigger = load("std_srvs/Trigger")
    assert load("std_srvs/srv/Trigger_Request") is trigger.Request
    assert load("std_srvs::srv::dds_::Trigger_Response_") is trigger.Response


def test_class():
    cls = load("std_msgs/Int32")
    assert repr(cls(data=5)) == "std_msgs.msg.Int32(data=5)"
    assert cls(5) == cls(data=5) != cls()
    assert cls(5) != 5
    assert cls._TYPE == "std_msgs/msg/Int32"
    assert cls._DDS_TYPE == "std_msgs::msg::dds_::Int32_"
    assert cls._HASH == known_hash("std_msgs/msg/Int32")
    assert cls._FIELDS == (("data", "int32"),)
    assert cls.get_fields_and_field_types() == {"data": "int32"}
    with pytest.raises(AttributeError):
        cls().other = 1
    with pytest.raises(TypeError):
        cls(other=1)


def test_field_types_as_rclpy_spells_them():
    assert load("sensor_msgs/CameraInfo")._FIELDS == (
        ("header", "std_msgs/Header"),
        ("height", "uint32"),
        ("width", "uint32"),
        ("distortion_model", "string"),
        ("d", "sequence<double>"),
        ("k", "double[9]"),
        ("r", "double[9]"),
        ("p", "double[12]"),
        ("binning_x", "uint32"),
        ("binning_y", "uint32"),
        ("roi", "sensor_msgs/RegionOfInterest"),
    )
    assert dict(load("rmw_dds_common/NodeEntitiesInfo")._FIELDS) == {
        "node_namespace": "string<256>",
        "node_name": "string<256>",
        "reader_gid_seq": "sequence<rmw_dds_common/Gid>",
        "writer_gid_seq": "sequence<rmw_dds_common/Gid>",
    }


def test_service():
    cls = load("nav_msgs/srv/LoadMap")
    assert cls._HASH == known_hash("nav_msgs/srv/LoadMap")
    assert cls.Response.RESULT_UNDEFINED_FAILURE == 255
    assert repr(cls.Request(map_url="x")) == "nav_msgs.srv.LoadMap_Request(map_url='x')"
    assert cls.Request._DDS_TYPE == "nav_msgs::srv::dds_::LoadMap_Request_"
    assert repr(load("std_srvs/Empty").Request()) == "std_srvs.srv.Empty_Request()"


def test_action():
    """Names and hashes as rclpy has them; the hashes are in installed_hashes.txt."""
    cls = load("test_msgs/Fibonacci")
    assert load("test_msgs::action::dds_::Fibonacci_") is cls
    from uros.interfaces.test_msgs.action import Fibonacci

    assert Fibonacci is cls and cls.__module__ == "uros.interfaces.test_msgs.action._fibonacci"
    impl = cls.Impl
    for part, whole in (
        (cls.Goal, "Goal"), (cls.Result, "Result"), (cls.Feedback, "Feedback"),
        (impl.SendGoalService, "SendGoal"), (impl.SendGoalService.Request, "SendGoal_Request"),
        (impl.GetResultService.Response, "GetResult_Response"),
        (impl.FeedbackMessage, "FeedbackMessage"),
    ):  # fmt: skip
        name = f"test_msgs/action/Fibonacci_{whole}"
        assert part._TYPE == name and load(name) is part
        assert part._HASH == known_hash(name)
        assert part._DDS_TYPE == f"test_msgs::action::dds_::Fibonacci_{whole}_"
        assert load(part._DDS_TYPE) is part
    assert cls._HASH == known_hash("test_msgs/action/Fibonacci")
    assert impl.CancelGoalService is load("action_msgs/srv/CancelGoal")
    assert impl.GoalStatusMessage is load("action_msgs/msg/GoalStatusArray")
    assert impl.SendGoalService.Request._FIELDS == (
        ("goal_id", "unique_identifier_msgs/UUID"), ("goal", "test_msgs/Fibonacci_Goal"),
    )  # fmt: skip
    assert impl.GetResultService.Response._FIELDS == (
        ("status", "int8"), ("result", "test_msgs/Fibonacci_Result"),
    )  # fmt: skip
    for name in ("Fibonacci_Request", "Fibonacci_Cancel", "Fibonacci_SendGoal_Goal", "Fib_Goal"):
        with pytest.raises(InterfaceError, match="unknown type"):
            load("test_msgs/action/" + name)


def test_defaults_and_constants(tmp_path):
    text = (
        "int32 A=7\nstring NAME='x'\nint32 a 5\nstring b 'hi'\nfloat32[2] c [1.5, -2]\n"
        "bool d true\n"
        "uint8[] e [1, 2]\nstring[] f ['p', 'q']\nfloat64 g inf\nint16[] h [3]\nfloat32[3] i\n"
        "string[2] j\nbool[] k\nuint8[2] l\nbyte m 9\n"
    )
    write(tmp_path / "def_cases" / "D.msg", text)
    add_folder(tmp_path / "def_cases")
    cls = load("def_cases/D")
    assert (cls.A, cls.NAME) == (7, "x")
    assert repr(cls()) == (
        "def_cases.msg.D(a=5, b='hi', c=[1.5, -2.0], d=True, e=[1, 2], f=['p', 'q'], g=inf,"
        " h=[3], i=[0.0, 0.0, 0.0], j=['', ''], k=[], l=[0, 0], m=9)"
    )
    assert load("geometry_msgs/Quaternion")().w == 1.0
    assert load("sensor_msgs/NavSatStatus")().status == -2
    first, second = cls(), cls()
    first.c[0] = 9.0
    first.f.append("r")
    assert second == cls()
    pose = load("geometry_msgs/PoseArray")
    pose().poses.append(1)
    assert pose().poses == []


def test_names_that_collide(tmp_path):
    """Fields named as methods, keywords and helpers; types with one plain name."""
    fields = ("self", "pack_into", "class", "size", "array", "len", "offset", "buf", "o", "end")
    text = "".join(f"int32 {name}\n" for name in fields) + "int32[] int\n"
    text += "std_msgs/Header h\nHeader h2\nMessage h3\n"
    write(tmp_path / "odd_cases/msg/Odd.msg", text)
    write(tmp_path / "odd_cases/msg/Header.msg", "std_msgs/Header header\nint8 x\n")
    write(tmp_path / "odd_cases/msg/Message.msg", "int8 x\n")
    add_folder(tmp_path)
    cls = load("odd_cases/Odd")
    msg = cls(self_=1, pack_into_=2, class_=3, size=4, array=5, int=[6])
    msg.h2.x = 3
    msg.h3.x = 4
    from uros.interfaces.codec import from_cdr, to_cdr

    assert from_cdr(cls, to_cdr(msg)) == msg
    assert [name for name, _ in cls._FIELDS][:3] == ["self", "pack_into", "class"]


def test_import_hook():
    from uros.interfaces.geometry_msgs import msg as geometry
    from uros.interfaces.std_msgs.msg import Int32, String
    from uros.interfaces.std_srvs.srv import Trigger

    assert Int32 is load("std_msgs/Int32")
    assert String(data="x").data == "x"
    assert Trigger is load("std_srvs/srv/Trigger")
    assert geometry.Twist().linear.x == 0.0
    assert "Twist" in dir(geometry)
    assert Int32.__module__ == "uros.interfaces.std_msgs.msg._int32"
    with pytest.raises(ImportError):
        from uros.interfaces.std_msgs.msg import Nothing  # noqa: F401
    for name in ("no_such_pkg", "std_msgs.other", "std_msgs.msg._nothing", "std_msgs.msg._a.b"):
        with pytest.raises(ImportError):
            importlib.import_module("uros.interfaces." + name)


def test_import_is_light():
    """The import loads no further module, and a class needs neither numpy nor rosbags."""
    code = (
        "import sys; before = set(sys.modules); import uros.interfaces\n"
        "new = set(sys.modules) - before\n"
        "light = {'__future__', 'uros', 'uros.moved', 'uros.interfaces'}\n"
        "assert new <= light | {'uros.interfaces.errors'}, new\n"
        "uros.interfaces.load('sensor_msgs/Imu')\n"
        "assert not {'numpy', 'rosbags'} & set(sys.modules)\n"
    )
    source = str(Path(uros.interfaces.__file__).parents[2])
    environment = {**os.environ, "PYTHONPATH": source}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)


def test_unknown_type():
    with pytest.raises(InterfaceError) as caught:
        load("std_msgs/msg/Int23")
    assert "did you mean std_msgs/msg/Int" in str(caught.value)
    assert "--interfaces DIR" in str(caught.value)
    with pytest.raises(InterfaceError, match="did you mean geometry_msgs/msg/Twist"):
        load("std_msgs/Twist")
    for bad in ("Int32", "", "a/b/c/d", "std_msgs/what/Int32", "/msg/", "a::b::c::d"):
        with pytest.raises(InterfaceError, match="bad type name"):
            load(bad)
    with pytest.raises(InterfaceError, match="unknown type"):
        load("../msg/Int32")


def test_package_folder(tmp_path):
    write(tmp_path / "my_a/msg/One.msg", "std_msgs/Header h\nTwo[] t\n")
    write(tmp_path / "my_a/msg/Two.msg", "int32 x\n")
    write(tmp_path / "my_a/srv/Do.srv", "Two a\n---\nint32 b\n")
    assert known_hash("my_a/msg/One") is None
    assert add_folder(tmp_path / "my_a") == ["my_a/msg/One", "my_a/msg/Two", "my_a/srv/Do"]
    assert load("my_a/One")().t == []
    assert load("my_a/Do").Request().a == load("my_a/Two")()
    assert (known_hash("my_a/msg/One") or "").startswith("RIHS01_")
    assert "my_a/srv/Do" in list_types()
    from uros.interfaces.my_a.msg import One

    assert One is load("my_a/One")


def test_workspace_flat_and_msg_folder(tmp_path):
    write(tmp_path / "ws/src/my_b/msg/B.msg", "int32 x\n")
    write(tmp_path / "ws/src/repo-main/msg/C.msg", "int32 x\n")
    write(tmp_path / "ws/src/repo-main/package.xml", "<package><name>my_c</name></package>")
    write(tmp_path / "ws/.git/msg/X.msg", "int32 x\n")
    assert add_folder(tmp_path / "ws") == ["my_b/msg/B", "my_c/msg/C"]
    write(tmp_path / "my_d/D.msg", "int32 x\n")
    write(tmp_path / "my_d/Go.action", "int32 x\n---\n---\n")
    assert add_folder(tmp_path / "my_d") == ["my_d/action/Go", "my_d/msg/D"]
    assert add_folder(tmp_path / "ws/src/my_b/msg") == ["my_b/msg/B"]
    assert load("my_d/Go").Goal(x=3).x == 3


def test_bad_folders(tmp_path):
    with pytest.raises(InterfaceError, match="no such folder"):
        add_folder(tmp_path / "none")
    with pytest.raises(InterfaceError, match="no .msg, .srv or .action file"):
        add_folder(tmp_path)


def test_a_broken_file_affects_only_its_own_type(tmp_path):
    write(tmp_path / "my_e/msg/Good.msg", "int32 x\n")
    write(tmp_path / "my_e/msg/Bad.msg", "int32 x\nint33 y\n")
    write(tmp_path / "my_e/msg/Outer.msg", "Bad b\n")
    write(tmp_path / "my_e/msg/Lost.msg", "nowhere_msgs/Thing b\n")
    write(tmp_path / "my_e/msg/Ring.msg", "Ring[] r\n")
    write(tmp_path / "my_e/msg/Big.msg", "#" * (registry.MAX_FILE + 1))
    (tmp_path / "my_e/msg/Binary.msg").write_bytes(b"\xff\xfe\x00")
    add_folder(tmp_path)
    assert "my_e/msg/Bad" in list_types()
    assert load("my_e/Good")(1).x == 1
    for name, fault in {
        "Bad": r"Bad.msg:2: unknown type 'int33'",
        "Outer": r"Outer.msg: .*Bad.msg:2: unknown type",
        "Lost": r"Lost.msg: unknown type 'nowhere_msgs/msg/Thing'.*--interfaces",
        "Ring": "contains itself",
        "Big": "over 1048576 bytes",
        "Binary": "Binary.msg: not UTF-8",
    }.items():
        with pytest.raises(InterfaceError, match=fault):
            load("my_e/" + name)
        assert known_hash("my_e/msg/" + name) is None


def test_ament_prefix_path(tmp_path, monkeypatch):
    write(tmp_path / "share/my_f/msg/F.msg", "int32 x\n")
    write(tmp_path / "share/std_msgs/msg/Int32.msg", "int64 data\n")
    assert known_hash("my_f/msg/F2") is None
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path}/none{os.pathsep}{tmp_path}")
    assert "my_f/msg/F" in list_types()
    assert load("my_f/F")(3).x == 3
    assert registry.message("std_msgs/msg/Int32").fields[0].type.name == "int32"
    from uros.interfaces.my_f.msg import F

    assert F is load("my_f/F")


def test_added_folders_go_first(tmp_path):
    write(tmp_path / "std_msgs/msg/UInt16.msg", "uint32 data\n")
    before = known_hash("std_msgs/msg/UInt16")
    add_folder(tmp_path)
    assert registry.message("std_msgs/msg/UInt16").fields[0].type.name == "uint32"
    assert known_hash("std_msgs/msg/UInt16") not in (None, before)


def test_folders_of_the_variable_come_between_added_and_packaged_ones(tmp_path, monkeypatch):
    for at, name in enumerate(("first", "second", "added")):
        write(tmp_path / f"{name}/std_msgs/msg/UInt16.msg", f"int{8 << at} data\n")
    write(tmp_path / "second/my_e/msg/E.msg", "int8 data\n")

    def kind():
        registry._definition.cache_clear()
        return registry.message("std_msgs/msg/UInt16").fields[0].type.name

    folders = os.pathsep.join(str(tmp_path / name) for name in ("first", "", "second"))
    monkeypatch.setenv("UROS_INTERFACES", folders.replace(f"{tmp_path}{os.pathsep}", os.pathsep))
    assert kind() == "int8"
    assert "my_e/msg/E" in list_types() and registry.names_in("my_e", "msg") == ["E"]
    assert load("my_e/E")(data=3).data == 3
    add_folder(tmp_path / "added")
    assert kind() == "int32"
    monkeypatch.delenv("UROS_INTERFACES")
    assert "my_e/msg/E" not in list_types()


def test_a_wrong_folder_in_the_variable(tmp_path, monkeypatch):
    monkeypatch.setenv("UROS_INTERFACES", str(tmp_path / "lost"))
    with pytest.raises(InterfaceError, match="^UROS_INTERFACES: .*/lost: no such folder"):
        load("my_x/X")


@pytest.mark.parametrize(
    "name, close",
    [
        ("std_msg/msg/String", "std_msgs/msg/String?)"),
        ("std_msg/String", "std_msgs/msg/String?)"),
        ("std_msgs/msg/string", "std_msgs/msg/String?)"),
        ("String", "std_msgs/msg/String or example_interfaces/msg/String"),
        ("std_srvs/srv/SetBol", "std_srvs/srv/SetBool?)"),
        ("std_msgs/msg/Strin", "std_msgs/msg/String?)"),
        ("geometry_msgs/msg/Twst", "geometry_msgs/msg/Twist?)"),
        (
            "std_msgs/msg/Int",
            "std_msgs/msg/Int8 or std_msgs/msg/Int16 or std_msgs/msg/Int32 or std_msgs/msg/Int64?)",
        ),
        ("Twist", "geometry_msgs/msg/Twist"),
        ("Twst", "geometry_msgs/msg/Twist"),
        ("sensor_msgs.msg.Imu", "sensor_msgs/msg/Imu"),
        ("std_srv/srv/Trigger", "std_srvs/srv/Trigger"),
    ],
)
def test_the_plausible_type_comes_first(name, close):
    with pytest.raises(InterfaceError) as caught:
        load(name)
    assert f"(did you mean {close}" in str(caught.value)


@pytest.mark.parametrize("name", registry.packaged_types())
def test_generated_source_suits_micropython(name):
    """No import, syntax or call that MicroPython 1.27 lacks (the board tests run it for real)."""
    tree = ast.parse(generate(registry.definition(name)))
    for node in ast.walk(tree):
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            module = getattr(node, "module", None) or node.names[0].name
            assert module.split(".")[0] not in MISSING_ON_BOARD
        assert not isinstance(node, (ast.Match, ast.Starred, ast.JoinedStr, ast.AnnAssign))
        if isinstance(node, ast.Call):
            assert len(node.args) <= 100
        if isinstance(node, ast.ClassDef):
            assert not node.keywords
        if isinstance(node, ast.FunctionDef):
            assert not node.args.posonlyargs
        if isinstance(node, ast.Attribute):
            assert node.attr not in ("tobytes", "cast", "frombytes", "byteswap", "Struct")


def test_write_package(tmp_path):
    paths = write_package(["sensor_msgs/Imu", "std_srvs/srv/SetBool_Request"], tmp_path)
    assert [str(p.relative_to(tmp_path)) for p in paths] == [
        "builtin_interfaces/__init__.py",
        "builtin_interfaces/msg/__init__.py",
        "builtin_interfaces/msg/_time.py",
        "geometry_msgs/__init__.py",
        "geometry_msgs/msg/__init__.py",
        "geometry_msgs/msg/_quaternion.py",
        "geometry_msgs/msg/_vector3.py",
        "sensor_msgs/__init__.py",
        "sensor_msgs/msg/__init__.py",
        "sensor_msgs/msg/_imu.py",
        "std_msgs/__init__.py",
        "std_msgs/msg/__init__.py",
        "std_msgs/msg/_header.py",
        "std_srvs/__init__.py",
        "std_srvs/srv/__init__.py",
        "std_srvs/srv/_setbool.py",
    ]
    code = (
        "import sys\nfrom std_msgs.msg import Header\nassert 'sensor_msgs' not in sys.modules\n"
        "from sensor_msgs.msg import Imu\nfrom std_srvs.srv import SetBool\n"
        "assert Imu(Header(frame_id='x')).cdr_size() == 312 and SetBool.Request(True).data\n"
        "try:\n    from std_msgs.msg import Int32\nexcept ImportError: pass\n"
    )
    source = Path(uros.interfaces.__file__).parents[2]
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{source}"}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)


def test_an_action_is_written_with_the_types_of_every_action(tmp_path):
    paths = write_package(["test_msgs/action/Fibonacci_SendGoal"], tmp_path)
    modules = {str(p.relative_to(tmp_path)) for p in paths if p.name != "__init__.py"}
    assert modules == {
        "action_msgs/msg/_goalinfo.py", "action_msgs/msg/_goalstatus.py",
        "action_msgs/msg/_goalstatusarray.py", "action_msgs/srv/_cancelgoal.py",
        "builtin_interfaces/msg/_time.py", "test_msgs/action/_fibonacci.py",
        "unique_identifier_msgs/msg/_uuid.py",
    }  # fmt: skip


def test_types_that_differ_in_case(tmp_path):
    write(tmp_path / "my_g/msg/FooBar.msg", "int32 x\n")
    write(tmp_path / "my_g/msg/Foobar.msg", "int8 x\n")
    if len(list((tmp_path / "my_g/msg").iterdir())) < 2:
        pytest.skip("this file system does not tell case apart")
    add_folder(tmp_path)
    with pytest.raises(InterfaceError, match="differ only in case"):
        write_package(["my_g/FooBar", "my_g/Foobar"], tmp_path / "out")
    assert load("my_g/FooBar")
    with pytest.raises(InterfaceError, match="differ only in case"):
        load("my_g/Foobar")


def test_the_event_of_a_service_and_of_an_actions_services():
    """It nests at most one request and one response, also empty ones."""
    trigger = load("std_srvs/srv/Trigger")
    event = load("std_srvs/srv/Trigger_Event")
    assert event._DDS_TYPE == "std_srvs::srv::dds_::Trigger_Event_"
    sent = event(request=[trigger.Request()], response=[trigger.Response(message="x")])
    sent.info.client_gid = bytes(range(16))
    assert from_cdr(event, to_cdr(sent)) == sent
    with pytest.raises(ValueError):
        to_cdr(event(request=[trigger.Request()] * 2))
    for name in ("test_msgs/action/Fibonacci_SendGoal_Event", "action_msgs/srv/CancelGoal_Event"):
        assert known_hash(name) == load(name)._HASH != ""
