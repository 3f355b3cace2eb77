"""Classes of virtual boards: an unknown field is rejected, with similar names in the error."""

from uros.interfaces.checked import checked, meant


class Pose:
    __slots__ = ("x", "frame_id")
    __setattr__ = checked("a/msg/Pose", ("x", "frame_id"), "")


def refusal(message, name):
    try:
        setattr(message, name, 1)
    except AttributeError as error:
        return str(error)
    raise AssertionError(name + " is taken")


def test_fields_are_assigned_and_other_names_rejected():
    pose = Pose()
    pose.x = 2
    assert pose.x == 2
    assert refusal(pose, "frameid") == "a/msg/Pose has no field frameid; did you mean frame_id?"
    assert refusal(pose, "zzz") == "a/msg/Pose has no field zzz; it has x, frame_id"


def test_similar_names_in_the_error():
    assert meant("volts", ("voltage", "current")) == "; did you mean voltage?"
    assert meant("X", ("x",)) == "; did you mean x?"
    assert meant("x", (), ("linear.x",)) == "; did you mean linear.x?"
    assert meant("x", ()) == "; it has none"
    assert meant("", ("ab",)) == "; it has ab"
    names = ["field%d" % i for i in range(20)]
    assert meant("qqq", names).endswith("field7, ...")
    assert meant("field", names).count("field") == 3
    assert meant("a" * 100000, ("a" * 100000,)).startswith("; did you mean")
