import re

import pytest

from uros.tools.bag.selection import Names, Selection

STRING = "std_msgs/msg/String"
EVENT = "std_srvs/srv/Trigger_Event"
ALL = Names(every=True)


def some(*names):
    return Names(included=frozenset(names))


def without(*names):
    return Names(every=True, excluded=frozenset(names))


@pytest.mark.parametrize(
    "selection, topic, expected",
    [
        (Selection(ALL), "/chatter", True),
        (Selection(ALL), "/go/_service_event", False),
        (Selection(ALL), "/_hidden/x", False),
        (Selection(ALL, hidden=True), "/_hidden/x", True),
        (Selection(ALL), "/fib/_action/feedback", False),
        (Selection(ALL, hidden=True), "/fib/_action/feedback", True),
        (Selection(ALL, hidden=True), "/fib/_action/send_goal/_service_event", False),
        (Selection(some("/chatter")), "/chatter", True),
        (Selection(some("/chatter")), "/chatter2", False),
        (Selection(some("/_hidden/x")), "/_hidden/x", True),
        (Selection(some("/fib/_action/feedback")), "/fib/_action/feedback", True),
        (Selection(without("/chatter")), "/chatter", False),
        (Selection(services=ALL), "/go/_service_event", True),
        (Selection(services=ALL), "/chatter", False),
        (Selection(services=ALL), "/fib/_action/send_goal/_service_event", False),
        (Selection(services=some("/go")), "/go/_service_event", True),
        (Selection(services=without("/go")), "/go/_service_event", False),
        (Selection(actions=ALL), "/fib/_action/status", True),
        (Selection(actions=ALL), "/fib/_action/get_result/_service_event", True),
        (Selection(actions=some("/fib")), "/fib/_action/cancel_goal/_service_event", True),
        (Selection(actions=some("/fib")), "/fob/_action/status", False),
        (Selection(actions=ALL), "/_hidden/fib/_action/status", False),
        (Selection(services=ALL), "/_hidden/go/_service_event", False),
        (Selection(actions=without("/fib")), "/fib/_action/status", False),
        (Selection(types=frozenset([STRING])), "/chatter", True),
        (Selection(types=frozenset(["std_msgs/msg/Int32"])), "/chatter", False),
        (Selection(ALL, excluded_types=frozenset([STRING])), "/chatter", False),
        (Selection(regex=re.compile("chat")), "/chatter", True),
        (Selection(regex=re.compile("^/go$")), "/go/_service_event", True),
        (Selection(regex=re.compile("fib")), "/fib/_action/status", True),
        (Selection(regex=re.compile("x")), "/_hidden/x", False),
        (Selection(ALL, excluded_regex=re.compile("ter$")), "/chatter", False),
        (Selection(ALL, excluded_regex=re.compile("x")), "/chatter", True),
        (Selection(some("/chatter"), excluded_regex=re.compile("chat")), "/chatter", False),
    ],
)
def test_what_is_taken(selection, topic, expected):
    assert selection.takes(topic, EVENT if "_service_event" in topic else STRING) is expected


def test_an_empty_selection():
    assert Selection().is_empty
    assert Selection(topics=without("/x"), excluded_regex=re.compile("x")).is_empty is False
    assert Selection(topics=Names(excluded=frozenset(["/x"]))).is_empty
    assert not Selection(regex=re.compile("x")).is_empty
    assert not Selection(types=frozenset([STRING])).is_empty


def test_missing_names_are_those_of_topics_services_and_actions():
    selection = Selection(some("/chatter", "/gone"), some("/go", "/stay"), some("/fib", "/fob"))
    present = ["/chatter", "/go/_service_event", "/fib/_action/status"]
    assert selection.missing(present) == ["/fob", "/gone", "/stay"]
