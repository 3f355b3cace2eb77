"""Kinds of objects: each has a name, and a parent or none."""

import pytest

from uros.agent.objects.kinds import (
    KIND_NAMES,
    PARENTS,
    WITH_NODE,
    key_label,
    object_label,
    parent_id,
)
from uros.agent.policy.config_values import key_of
from uros.wire import ids


def test_every_kind_that_can_be_created_has_a_name_of_its_own():
    kinds = {item for name, item in vars(ids).items() if name.startswith("KIND_")}
    not_creatable = {ids.KIND_INVALID, ids.KIND_AGENT, ids.KIND_CLIENT, ids.KIND_OTHER}
    assert set(KIND_NAMES) == kinds - not_creatable
    assert len(set(KIND_NAMES.values())) == len(KIND_NAMES)
    assert set(WITH_NODE) <= set(KIND_NAMES) and set(PARENTS) <= set(KIND_NAMES)


@pytest.mark.parametrize("kind", KIND_NAMES, ids=KIND_NAMES.get)
def test_the_parent_has_the_right_kind_whatever_kind_the_client_sent(kind):
    parents = {parent_id(kind, 0x0120 | written) for written in range(16)}
    if kind in PARENTS:
        assert parents == {0x0120 | PARENTS[kind]}
    else:
        assert parents == {0}


def test_labels_are_those_of_the_log_and_a_key_can_be_given_back():
    assert object_label(0x0015) == "0x001(5)" and object_label(0xFFFE) == "0xFFF(14)"
    assert key_label(0x4B0CBE99) == "0x4B0CBE99" and key_of(key_label(7)) == 7
