"""Things with several users, and that nothing of them stays."""

from uros.middleware import open_middleware
from uros.middleware.dds.shared import Shared
from uros.qos import QoSProfile


def test_made_once_and_unmade_after_the_last_user():
    made, unmade = [], []

    def make(key):
        made.append(key)
        return key.upper()

    shared = Shared(make, unmade.append)
    assert [shared.get("a"), shared.get("a"), shared.get("b")] == ["A", "A", "B"]
    shared.release("a")
    assert (made, unmade, len(shared)) == (["a", "b"], [], 2)
    shared.release("a")
    assert (unmade, len(shared)) == (["A"], 1)
    assert shared.get("a") == "A"
    assert made == ["a", "b", "a"]


def test_what_cannot_be_made_has_no_user():
    def make(key):
        raise ValueError(key)

    shared = Shared(make, print)
    for _ in range(2):
        try:
            shared.get("a")
        except ValueError:
            pass
    assert len(shared) == 0


def test_ever_new_topics_and_partitions_leave_nothing_behind(own_domain_id):
    middleware = open_middleware("dds")
    try:
        node = middleware.create_node(own_domain_id, "/", "node")
        participant = node.participant
        before = len(participant._topics), len(participant._groups), len(middleware.local)
        for i in range(40):
            qos = QoSProfile(partitions=(f"part{i}",))
            type_name = "std_msgs::msg::dds_::Int32_"
            writer = node.create_writer(f"rt/topic{i}", type_name, qos)
            reader = node.create_reader(f"rt/topic{i}", type_name, qos, lambda: None)
            writer.close()
            reader.close()
        after = len(participant._topics), len(participant._groups), len(middleware.local)
        assert after == before
    finally:
        middleware.close()
