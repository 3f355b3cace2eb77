import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.tools.tf import frames
from uros.tools.tf.frames import FrameTree, NoTransformError, Stamped
from uros.tools.tf.transforms import IDENTITY, Transform

S = 1_000_000_000


def moved(x, stamp=0):
    return Stamped(Transform((float(x), 0.0, 0.0), IDENTITY.rotation), stamp)


def tree_of(*links):
    """A tree of links (parent, child, x), all static and received at 0."""
    tree = FrameTree()
    for parent, child, x in links:
        tree.add(parent, child, moved(x), 0, True)
    return tree


def x_of(tree, source, target):
    return tree.lookup(source, target).transform.translation[0]


ROBOT = (("map", "odom", 1), ("odom", "base", 10), ("base", "laser", 100), ("base", "arm", 1000))


def test_look_up_through_the_common_ancestor():
    tree = tree_of(*ROBOT)
    assert x_of(tree, "map", "laser") == 111.0 and x_of(tree, "laser", "map") == -111.0
    assert x_of(tree, "laser", "arm") == 900.0 and x_of(tree, "arm", "arm") == 0.0
    assert x_of(tree, "/map", "/base") == 11.0  # a slash in front does not count


def test_the_latest_common_time_is_that_of_the_slowest_link():
    tree = FrameTree()
    for second in range(5):
        tree.add("map", "odom", moved(second, second * S), second * S)
    for tenth in range(90):
        tree.add("odom", "base", moved(tenth * 100, tenth * S // 10), tenth * S // 10)
    tree.add("base", "laser", moved(0.5), 0, True)
    found = tree.lookup("map", "laser")
    assert found.stamp_ns == 4 * S and found.transform.translation[0] == 4 + 4000 + 0.5
    assert tree.lookup("base", "laser").stamp_ns == 0  # static alone


def test_frames_without_a_transform():
    tree = tree_of(*ROBOT, ("world", "house", 1))
    for source, target, said in (
        ("map", "lasr", "there is no frame 'lasr'; did you mean 'laser'?"),
        ("nothing", "map", "there is no frame 'nothing'"),
        ("house", "arm", "'house' and 'arm' are in two trees, with the roots 'world' and 'map'"),
    ):
        with pytest.raises(NoTransformError) as caught:
            tree.lookup(source, target)
        assert str(caught.value) == said
    with pytest.raises(NoTransformError, match="there is no frame 'a'"):
        FrameTree().lookup("a", "b")


def test_loops_are_found():
    tree = tree_of(("b", "a", 1), ("c", "b", 1), ("a", "c", 1), ("a", "d", 1), ("map", "x", 1))
    assert tree.loops() == [["a", "b", "c"]] and tree.roots() == ["map"]
    with pytest.raises(NoTransformError, match="'d' is in a loop of parents, with 'a'"):
        tree.lookup("d", "x")
    assert tree_of(*ROBOT).loops() == []


def test_two_parents_are_found_until_one_is_not_repeated():
    tree = tree_of(*ROBOT)
    tree.add("wall", "moving", moved(1), 0, writer=b"1")
    tree.add("floor", "moving", moved(2), 1, writer=b"2")
    ((child, links),) = tree.two_parents()
    assert child == "moving" and [link.parent for link in links] == ["wall", "floor"]
    assert tree.link("moving").parent == "floor"
    tree.add("wall", "moving", moved(1), 2)
    assert tree.link("moving").parent == "wall" and len(list(tree.two_parents())) == 1
    tree.add("wall", "moving", moved(1), 11 * S)
    assert list(tree.two_parents()) == []


def test_the_rate_is_that_of_the_transforms_received():
    tree = FrameTree()
    tree.add("map", "odom", moved(0), 5 * S)
    assert tree.link("odom").rate is None
    for tenth in range(1, 21):
        tree.add("map", "odom", moved(0), 5 * S + tenth * S // 10)
    assert tree.link("odom").rate == pytest.approx(10.0)


def test_what_is_no_transform_is_refused(monkeypatch):
    tree = tree_of(("a", "a", 1), ("", "b", 1), ("/", "c", 1))
    assert tree.frames() == [] and tree.refused == {
        "a": "it is its own parent",
        "b": "the parent or the child is empty",
        "c": "the parent or the child is empty",
    }
    monkeypatch.setattr(frames, "_MOST_FRAMES", 3)
    tree = tree_of(*[("map", str(number), 1) for number in range(9)])
    assert len(tree.frames()) == 4 and tree.refused == {"": "there are more than 3 frames"}
    for number in range(9):
        tree.refuse(str(number), "x")
    assert len(tree.refused) == 3


NAMES = st.sampled_from("abcdef")


@given(st.lists(st.tuples(NAMES, NAMES, st.integers(-9, 9))), NAMES, NAMES)
def test_any_links_make_a_tree_or_are_refused(links, source, target):
    tree = tree_of(*links)
    tree.roots()
    list(tree.two_parents())
    try:
        there = x_of(tree, source, target)
    except NoTransformError:
        return
    assert x_of(tree, target, source) == pytest.approx(-there)
    assert x_of(tree, source, source) == 0.0
