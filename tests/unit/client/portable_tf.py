"""The broadcasters of transforms. Also runs on MicroPython, with transforms of its own."""

from support.services import Bench, raised

from uros.client.dynamic_messages import Shape
from uros.client.tf import StaticTransformBroadcaster, TransformBroadcaster
from uros.wire import ids

SHAPE = Shape("geometry_msgs/msg/TransformStamped", "iIssddddddd")
HEARD = Shape("tf2_msgs/msg/TFMessage", "[iIssddddddd]")


class Transform:
    """A TransformStamped with the methods of a generated class that broadcasters call."""

    _TYPE = SHAPE._TYPE

    def __init__(self, child="base", x=0.0, frame="odom"):
        self.child_frame_id = child
        self.x = x
        self.frame = frame

    def values(self):
        return [5, 6, self.frame, self.child_frame_id, self.x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]

    def cdr_size(self, o=0):
        return SHAPE(self.values()).cdr_size(o)

    def pack_into(self, buf, offset, start):
        return SHAPE(self.values()).pack_into(buf, offset, start)

    @classmethod
    def unpack_from(cls, buf, offset, start, end, little=True):
        message, end = SHAPE.unpack_from(buf, offset, start, end, little)
        return cls(message.values[3], message.values[4], message.values[2]), end


def heard(bench, topic):
    """Return the messages of a topic, each as a list of (frame, child, x)."""
    bench.run(100)
    writer_id = bench.entity(topic).object_id(ids.KIND_DATAWRITER)
    out = []
    for object_id, sample in bench.agent.samples:
        if object_id == writer_id:
            message, _ = HEARD.unpack_from(bytes(sample), 0, 0, len(sample))
            assert message.cdr_size() == len(sample)
            out.append(
                [(transform[2], transform[3], transform[4]) for transform in message.values[0]]
            )
    bench.agent.samples.clear()
    return out


def test_one_or_several_transforms() -> None:
    bench = Bench(connect=False)
    broadcaster = TransformBroadcaster(bench.node)
    assert not broadcaster.sendTransform(Transform())  # there is no agent
    bench.connect()
    assert broadcaster.sendTransform(Transform("base_link", 1.5))
    assert broadcaster.sendTransform([Transform("a", 1.0), Transform("bb", 2.0, "ccc")])
    assert broadcaster.sendTransform([])
    assert heard(bench, "/tf") == [
        [("odom", "base_link", 1.5)],
        [("odom", "a", 1.0), ("ccc", "bb", 2.0)],
        [],
    ]
    assert bench.entity("/tf").depth == 100


def test_static_transforms_are_kept_and_sent_together() -> None:
    bench = Bench(connect=False)
    broadcaster = StaticTransformBroadcaster(bench.node)
    bench.connect()
    assert heard(bench, "/tf_static") == []
    camera = Transform("camera", 1.0)
    assert broadcaster.sendTransform(camera)
    camera.x = 99.0  # the program may change its message
    assert broadcaster.sendTransform([Transform("laser", 2.0), Transform("imu", 3.0)])
    assert broadcaster.sendTransform(Transform("laser", 4.0))
    assert heard(bench, "/tf_static") == [
        [("odom", "camera", 1.0)],
        [("odom", "camera", 1.0), ("odom", "laser", 2.0), ("odom", "imu", 3.0)],
        [("odom", "camera", 1.0), ("odom", "imu", 3.0), ("odom", "laser", 4.0)],
    ]
    qos = bench.entity("/tf_static").qos
    assert qos.transient_local and qos.reliable and qos.depth == 1


def test_static_transforms_are_sent_to_each_agent() -> None:
    bench = Bench(connect=False)
    broadcaster = StaticTransformBroadcaster(bench.node)
    broadcaster.sendTransform([Transform("camera", 1.0), Transform("laser", 2.0)])
    bench.connect()
    both = [[("odom", "camera", 1.0), ("odom", "laser", 2.0)]]
    assert heard(bench, "/tf_static") == both
    for _ in range(3):
        bench.lose()
        bench.connect()
        assert heard(bench, "/tf_static") == both
    assert bench.entity("/tf_static") not in bench.node.executor.handles


def test_static_transforms_without_room_are_sent_later() -> None:
    bench = Bench(connect=False)
    broadcaster = StaticTransformBroadcaster(bench.node)
    bench.connect()
    publish = broadcaster.publisher.publish
    broadcaster.publisher.publish = lambda message: False  # the queue is full
    assert not broadcaster.sendTransform(Transform("camera", 1.0))
    assert heard(bench, "/tf_static") == []
    broadcaster.publisher.publish = publish
    bench.run(200)
    assert heard(bench, "/tf_static") == [[("odom", "camera", 1.0)]]
    assert bench.entity("/tf_static") not in bench.node.executor.handles


def test_a_failed_publication_is_retried_after_a_pause() -> None:
    bench = Bench(connect=False)
    broadcaster = StaticTransformBroadcaster(bench.node)
    broadcaster.sendTransform(Transform("camera", 1.0))
    publish = broadcaster.publisher.publish

    def starving(message):
        raise MemoryError

    broadcaster.publisher.publish = starving
    bench.connect()
    bench.run(1000)
    assert 5 < len(bench.errors) < 15
    broadcaster.publisher.publish = publish
    assert heard(bench, "/tf_static") == [[("odom", "camera", 1.0)]]


def test_other_types_are_refused_as_transforms() -> None:
    bench = Bench(connect=False)
    for broadcaster in (TransformBroadcaster(bench.node), StaticTransformBroadcaster(bench.node)):
        for wrong in (None, 5, [Transform(), "x"], SHAPE):
            if wrong is not SHAPE:
                text = raised(TypeError, broadcaster.sendTransform, wrong)
                assert "is no geometry_msgs/msg/TransformStamped" in text
    assert heard_nothing(bench)


def heard_nothing(bench):
    bench.connect()
    return heard(bench, "/tf_static") == [] and heard(bench, "/tf") == []
