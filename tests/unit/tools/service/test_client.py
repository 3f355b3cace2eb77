"""Calls of several services at once, with requesters that each test makes."""

from types import SimpleNamespace

import pytest

from uros.interfaces import load
from uros.interfaces.codec import from_cdr, to_cdr
from uros.middleware.base import MiddlewareError
from uros.tools.errors import ToolError
from uros.tools.service.client import Call, call_all

SET_BOOL = load("std_srvs/srv/SetBool")


class Requester:
    """Answers the request of its service in the turn of its number, counted from 0.

    Args:
        answers_in: The turn; None for never.
        matches_in: The turn from which on a server has matched; None for never.
        fails: Whether a request is refused by an error.
        busy: How many times there is no room for the request.
        says: Why there will be no response.
    """

    def __init__(self, answers_in=1, matches_in=0, fails=False, busy=0, says=""):
        self.answers_in, self.matches_in, self.fails = answers_in, matches_in, fails
        self.busy, self.says = busy, says
        self.turn = 0
        self.asked = []
        self.closed = False

    def servers(self):
        return int(self.matches_in is not None and self.turn >= self.matches_in)

    def request(self, cdr):
        assert self.servers()
        if self.fails:
            raise MiddlewareError("the server would misread it")
        if self.busy:
            self.busy -= 1
            return None
        self.asked.append(from_cdr(SET_BOOL.Request, cdr).data)
        return 7

    def refusal(self):
        return self.says

    def take(self, limit):
        if self.answers_in is None or self.turn < self.answers_in:
            return []
        return [(7, to_cdr(SET_BOOL.Response(success=True, message=str(self.turn))))]

    def close(self):
        self.closed = True


class Network:
    """A domain with these requesters by service, whose :meth:`spin` has ten turns."""

    TURNS = 10

    def __init__(self, requesters, interrupted_in=TURNS):
        self.requesters = requesters
        self.interrupted_in = interrupted_in
        self.node = self.graph = self
        self.turns = 0

    def create_requester(self, service, qos, on_ready):
        return self.requesters[service.request_topic.removeprefix("rq").removesuffix("Request")]

    def servers(self, service):
        return [SimpleNamespace()]

    def spin(self, done, seconds):
        for turn in range(self.TURNS):
            self.turns = turn
            for requester in self.requesters.values():
                requester.turn = turn
            if turn == self.interrupted_in:
                raise KeyboardInterrupt
            if done():
                return True
        return False


def called(network):
    calls = [Call(name, SET_BOOL, SET_BOOL.Request(data=True)) for name in network.requesters]
    return call_all(network, calls, 2.5)


def test_all_are_asked_at_once_and_answers_keep_the_order_of_the_calls():
    network = Network({"/slow": Requester(4), "/late": Requester(3, matches_in=2),
                       "/fast": Requester(1), "/full": Requester(1, busy=2)})  # fmt: skip
    assert [answer.message for answer in called(network)] == ["4", "3", "1", "2"]
    assert network.turns == 4
    assert all(one.asked == [True] and one.closed for one in network.requesters.values())


def test_each_that_has_no_answer_has_its_own_reason():
    network = Network({"/deaf": Requester(None), "/strict": Requester(matches_in=None),
                       "/other": Requester(fails=True), "/gone": Requester(None, says="it is gone"),
                       "/fine": Requester()})  # fmt: skip
    *errors, answer = called(network)
    assert answer.success and all(isinstance(error, ToolError) for error in errors)
    deaf, strict, other, gone = map(str, errors)
    assert deaf.startswith("/deaf did not answer within 2.5 s")
    assert strict.startswith("a server of /strict was found, but did not match within 2.5 s")
    assert (other, gone) == ("the server would misread it", "it is gone")
    assert all(one.closed for one in network.requesters.values())


def test_ctrl_c_closes_the_clients():
    network = Network({"/deaf": Requester(None)}, interrupted_in=1)
    with pytest.raises(KeyboardInterrupt):
        called(network)
    assert network.requesters["/deaf"].closed


def test_no_call_has_no_answer():
    assert called(Network({})) == []
