"""Reference-counted values, and that none of them outlives its users."""

import pytest

from uros.middleware import open_middleware
from uros.middleware.ref_counted import RefCounted
from uros.qos import QoSProfile


def test_created_once_and_destroyed_after_the_last_user():
    created, destroyed = [], []

    def create(key):
        created.append(key)
        return key.upper()

    shared = RefCounted(create, destroyed.append)
    assert [shared.acquire("a"), shared.acquire("a"), shared.acquire("b")] == ["A", "A", "B"]
    shared.release("a")
    assert (created, destroyed, len(shared)) == (["a", "b"], [], 2)
    shared.release("a")
    assert (destroyed, len(shared)) == (["A"], 1)
    assert shared.acquire("a") == "A"
    assert created == ["a", "b", "a"]


def test_a_value_that_cannot_be_created_has_no_user():
    def create(key):
        raise ValueError(key)

    shared = RefCounted(create, print)
    for _ in range(2):
        try:
            shared.acquire("a")
        except ValueError:
            pass
    assert len(shared) == 0


@pytest.mark.cyclone
def test_topics_and_partitions_of_closed_endpoints_are_deleted(own_domain_id):
    middleware = open_middleware("dds")
    try:
        node = middleware.create_node(own_domain_id, "/", "node")
        participant = node.participant
        before = len(participant._topics), len(participant._groups), len(middleware.context.readers)
        for i in range(40):
            qos = QoSProfile(partitions=(f"part{i}",))
            type_name = "std_msgs::msg::dds_::Int32_"
            writer = node.create_writer(f"rt/topic{i}", type_name, qos)
            reader = node.create_reader(f"rt/topic{i}", type_name, qos, lambda: None)
            writer.close()
            reader.close()
        after = len(participant._topics), len(participant._groups), len(middleware.context.readers)
        assert after == before
    finally:
        middleware.close()
