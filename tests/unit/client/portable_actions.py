"""Action server and action client, each with a scripted peer. Also runs on MicroPython."""

from support.board import KEY, FakeAgent, FakeClock
from support.services import raised

from uros.client import AGENT_CONNECTED, WAITING_AGENT, Node
from uros.client.action_client import ActionClient, random_uuid
from uros.client.action_server import ActionServer, Wait
from uros.client.actions import CancelResponse, GoalResponse, GoalStatus
from uros.client.entities import Future
from uros.wire import ids
from uros.wire.cdr import Reader
from uros.wire.entities import (
    pull_binary_endpoint,
    pull_binary_service,
    pull_binary_topic,
    pull_create,
)

# --- a small action with classes written by hand ------------------------------------------------


class Record:
    """A message; FIELDS are (name, kind): a size in octets, a class, or a list of one class."""

    FIELDS = ()
    _TYPE = ""

    def __init__(self, *values):
        for i, (name, kind) in enumerate(self.FIELDS):
            if i < len(values) and values[i] is not None:
                value = values[i]
            elif isinstance(kind, int):
                value = bytes(16) if kind == 16 else 0
            else:
                value = [] if isinstance(kind, list) else kind()
            setattr(self, name, value)

    def cdr_size(self, o=0):
        return o + len(self._put(b""))

    def pack_into(self, buf, offset, start):
        assert offset == start
        octets = self._put(b"")
        buf[offset : offset + len(octets)] = octets
        return offset + len(octets)

    def _put(self, out):
        # A loop: with a recursion, a board's stack has no room left for the client.
        pending = [(type(self), self)]
        while pending:
            kind, value = pending.pop()
            if kind == 16:
                out += value
            elif isinstance(kind, int):
                out += bytes(-len(out) % kind) + (value & (1 << 8 * kind) - 1).to_bytes(
                    kind, "little"
                )
            elif isinstance(kind, list):
                out += bytes(-len(out) % 4) + len(value).to_bytes(4, "little")
                pending += [(kind[0], item) for item in reversed(value)]
            else:
                fields = value.FIELDS
                pending += [(inner, getattr(value, name)) for name, inner in reversed(fields)]
        return out

    @classmethod
    def unpack_from(cls, buf, offset, start, end, little=True):
        assert offset == start and little
        return cls._get(bytes(buf[offset:end]), 0)[0], end

    @classmethod
    def _get(cls, octets, o):
        values = []
        for _, kind in cls.FIELDS:
            if kind == 16:
                value = octets[o : o + 16]
                o += 16
            elif isinstance(kind, int):
                o += -o % kind
                if o + kind > len(octets):
                    raise ValueError("too short")
                value = int.from_bytes(octets[o : o + kind], "little")
                o += kind
            elif isinstance(kind, list):
                o += -o % 4
                count = int.from_bytes(octets[o : o + 4], "little")
                o += 4
                value = []
                for _ in range(count):
                    item, o = kind[0]._get(octets, o)
                    value.append(item)
            else:
                value, o = kind._get(octets, o)
            values.append(value)
        return cls(*values), o


class UUID(Record):
    FIELDS = (("uuid", 16),)


class Time(Record):
    """A Time whose seconds are also set in halves, as the client's clock does."""

    FIELDS = (("sec", 4), ("nanosec", 4))
    high = property(None, lambda self, half: setattr(self, "sec", self.sec & 0xFFFF | half << 16))
    low = property(None, lambda self, half: setattr(self, "sec", self.sec & -65536 | half))


class GoalInfo(Record):
    FIELDS = (("goal_id", UUID), ("stamp", Time))


class Status(Record):
    FIELDS = (("goal_info", GoalInfo), ("status", 1))


class StatusArray(Record):
    _TYPE = "action_msgs/msg/GoalStatusArray"
    FIELDS = (("status_list", [Status]),)


class Cancel:
    class Request(Record):
        _TYPE = "action_msgs/srv/CancelGoal_Request"
        FIELDS = (("goal_info", GoalInfo),)

    class Response(Record):
        _TYPE = "action_msgs/srv/CancelGoal_Response"
        FIELDS = (("return_code", 1), ("goals_canceling", [GoalInfo]))


class Count:
    """Counts to ``goal.n``."""

    class Goal(Record):
        _TYPE = "test_msgs/action/Count_Goal"
        FIELDS = (("n", 4),)

    class Result(Record):
        _TYPE = "test_msgs/action/Count_Result"
        FIELDS = (("n", 4),)

    class Feedback(Record):
        _TYPE = "test_msgs/action/Count_Feedback"
        FIELDS = (("n", 4),)


class SendGoal:
    class Request(Record):
        _TYPE = "test_msgs/action/Count_SendGoal_Request"
        FIELDS = (("goal_id", UUID), ("goal", Count.Goal))

    class Response(Record):
        _TYPE = "test_msgs/action/Count_SendGoal_Response"
        FIELDS = (("accepted", 1), ("stamp", Time))


class GetResult:
    class Request(Record):
        _TYPE = "test_msgs/action/Count_GetResult_Request"
        FIELDS = (("goal_id", UUID),)

    class Response(Record):
        _TYPE = "test_msgs/action/Count_GetResult_Response"
        FIELDS = (("status", 1), ("result", Count.Result))


class FeedbackMessage(Record):
    _TYPE = "test_msgs/action/Count_FeedbackMessage"
    FIELDS = (("goal_id", UUID), ("feedback", Count.Feedback))


class Impl:
    SendGoalService = SendGoal
    CancelGoalService = Cancel
    GetResultService = GetResult
    FeedbackMessage = FeedbackMessage
    GoalStatusMessage = StatusArray
    Status = Status


Count.Impl = Impl

SEND_GOAL, CANCEL_GOAL, GET_RESULT = [n << 4 | ids.KIND_REPLIER for n in range(3)]
FEEDBACK, STATUS = [n << 4 | ids.KIND_DATAWRITER for n in range(2)]
ASK_GOAL, ASK_CANCEL, ASK_RESULT = [n << 4 | ids.KIND_REQUESTER for n in range(3)]
HEAR_FEEDBACK, HEAR_STATUS = [n << 4 | ids.KIND_DATAREADER for n in range(2)]


def octets_of(record):
    return record._put(b"")


def uuid(n):
    return bytes([n] * 16)


class Desk:
    """A node on a scripted agent."""

    def __init__(self, namespace=""):
        self.clock = FakeClock()
        self.agent = FakeAgent(self.clock, mtu=2048)
        self.node = Node("node", self.agent, namespace, key=KEY, clock=self.clock)
        self.errors = []
        self.node.executor.report = self.errors.append

    def run(self, ms=10):
        end = self.clock.t + ms * 1000
        while self.clock.t < end:
            self.node.spin_once((end - self.clock.t) / 1000000)

    def until(self, state):
        for _ in range(1000):
            if self.node.state == state:
                return
            self.node.spin_once(0.01)
        raise AssertionError(state)

    def lose(self):
        """Lose the agent; another one starts."""
        self.agent.silent = True
        self.until(WAITING_AGENT)
        self.agent.silent = False
        self.agent.forget()

    def take(self, object_id, kind, skip=0):
        """Remove and return the messages that the board has written to an object."""
        out = []
        for sample_id, sample in self.agent.samples:
            if sample_id == object_id:
                out.append(kind._get(sample[skip:], 0)[0])
        self.agent.samples = [sample for sample in self.agent.samples if sample[0] != object_id]
        return out


class ServerDesk(Desk):
    """An action server; the test is its client."""

    def __init__(self, execute=None, namespace="", name="count", **options):
        super().__init__(namespace)
        self.asked = 0
        self.server = ActionServer(self.node, Count, name, execute, **options)
        self.until(AGENT_CONNECTED)

    def ask(self, object_id, request):
        self.asked += 1
        self.agent.sample(object_id, bytes([self.asked] * 24) + octets_of(request))
        self.run(1)

    def answers(self, object_id, kind):
        """Return (identity, response) of each reply."""
        identities = [sample[1][0] for sample in self.agent.samples if sample[0] == object_id]
        return list(zip(identities, self.take(object_id, kind, 24)))

    def send(self, n, goal=3):
        """Send goal number n; return whether it is accepted."""
        self.ask(SEND_GOAL, SendGoal.Request(UUID(uuid(n)), Count.Goal(goal)))
        ((_, answer),) = self.answers(SEND_GOAL, SendGoal.Response)
        return bool(answer.accepted)

    def cancel(self, n=None, sec=0, nanosec=0):
        """Send CancelGoal; return (return code, numbers of the goals)."""
        info = GoalInfo(UUID(bytes(16) if n is None else uuid(n)), Time(sec, nanosec))
        self.ask(CANCEL_GOAL, Cancel.Request(info))
        ((_, answer),) = self.answers(CANCEL_GOAL, Cancel.Response)
        return answer.return_code, [
            goal_info.goal_id.uuid[0] for goal_info in answer.goals_canceling
        ]

    def ask_result(self, n):
        self.ask(GET_RESULT, GetResult.Request(UUID(uuid(n))))

    def results(self):
        """Return (identity, status, n) of each reply to get_result."""
        answers = self.answers(GET_RESULT, GetResult.Response)
        return [(identity, answer.status, answer.result.n) for identity, answer in answers]

    def states(self):
        """Return the published states, a list of (goal, state) for each message."""
        return [
            [(status.goal_info.goal_id.uuid[0], status.status) for status in message.status_list]
            for message in self.take(STATUS, StatusArray)
        ]

    def feedback(self):
        return [
            (message.goal_id.uuid[0], message.feedback.n)
            for message in self.take(FEEDBACK, FeedbackMessage)
        ]


def counting(goal):
    """Count one step each tenth of a second."""
    for i in range(goal.request.n):
        if goal.is_cancel_requested:
            goal.canceled()
            return Count.Result(i)
        goal.publish_feedback(Count.Feedback(i))
        yield 0.1
    goal.succeed()
    return Count.Result(goal.request.n)


# --- the server ---------------------------------------------------------------------------------


def test_a_servers_names_types_and_qos() -> None:
    desk = ServerDesk(counting, "arm", "lift")
    services, topics, qos = [], [], []
    for _, payload in desk.agent.creations:
        _, _, kind, _, content, _ = pull_create(Reader(payload, 0, len(payload), True))
        r = Reader(content, 0, len(content), True)
        if kind == ids.KIND_TOPIC:
            topics.append(pull_binary_topic(r))
        elif kind == ids.KIND_REPLIER:
            services.append(pull_binary_service(r))
        elif kind == ids.KIND_DATAWRITER:
            qos.append(pull_binary_endpoint(r, False)[1][:2])
    base = "/arm/lift/_action/"
    prefix = "test_msgs::action::dds_::Count_"
    assert services == [
        (
            base + name, type + "_Request_", type + "_Response_", "rq" + base + name + "Request",
            "rr" + base + name + "Reply",
        )
        for name, type in (
            ("send_goal", prefix + "SendGoal"),
            ("cancel_goal", "action_msgs::srv::dds_::CancelGoal"),
            ("get_result", prefix + "GetResult"),
        )
    ]  # fmt: skip
    assert topics == [
        ("rt" + base + "feedback", prefix + "FeedbackMessage_"),
        ("rt" + base + "status", "action_msgs::msg::dds_::GoalStatusArray_"),
    ]
    keep = ids.QOS_RELIABLE | ids.QOS_KEEP_LAST
    assert qos == [(keep, 10), (keep | ids.QOS_TRANSIENT_LOCAL, 1)]


def test_a_generator_executes_a_goal_in_steps() -> None:
    desk = ServerDesk(counting)
    started = desk.clock.t
    assert desk.send(1)
    assert desk.states() == [[(1, 1)], [(1, 2)]]
    desk.ask_result(1)
    desk.run(400)
    assert desk.feedback() == [(1, 0), (1, 1), (1, 2)]
    assert desk.states() == [[(1, 4)]]
    assert desk.results() == [(2, 4, 3)]
    (goal,) = desk.server.goals
    assert not goal.is_active and 300 <= (desk.clock.t - started) // 1000 <= 420
    # Later requests get the result, too.
    desk.ask_result(1)
    desk.ask_result(1)
    assert desk.results() == [(3, 4, 3), (4, 4, 3)]
    assert not desk.errors


def test_the_stamp_is_the_time_of_acceptance() -> None:
    desk = ServerDesk(counting)
    desk.run(100)
    desk.ask(SEND_GOAL, SendGoal.Request(UUID(uuid(1)), Count.Goal(3)))
    ((_, answer),) = desk.answers(SEND_GOAL, SendGoal.Response)
    now = desk.agent.epoch_us + desk.clock.t
    (goal,) = desk.server.goals
    stamp = goal._goal_status.goal_info.stamp
    assert (answer.stamp.sec, answer.stamp.nanosec) == (stamp.sec, stamp.nanosec)
    assert abs(answer.stamp.sec * 1000000 + answer.stamp.nanosec // 1000 - now) < 100000


def test_an_execute_callback_may_return_its_result_at_once() -> None:
    def execute(goal):
        if goal.request.n == 7:
            goal.abort()
        else:
            goal.succeed()
        return Count.Result(goal.request.n * 2)

    desk = ServerDesk(execute)
    assert desk.send(1, 21) and desk.send(2, 7)
    desk.ask_result(1)
    desk.ask_result(2)
    assert desk.results() == [(3, 4, 42), (4, 6, 14)]
    assert desk.states()[-1] == [(1, 4), (2, 6)]


def test_the_goal_callback_rejects_goals() -> None:
    goals = []

    def goal_callback(goal):
        goals.append(goal.n)
        if goal.n == 5:
            raise ValueError("five")
        return {1: GoalResponse.ACCEPT, 2: GoalResponse.REJECT, 3: None, 4: True}[goal.n]

    desk = ServerDesk(counting, goal_callback=goal_callback)
    assert [desk.send(n, n) for n in (1, 2, 3, 4, 5)] == [True, False, False, False, False]
    assert goals == [1, 2, 3, 4, 5]
    assert [str(error) for error in desk.errors] == ["five"]
    desk.ask_result(2)
    assert desk.results() == [(6, 0, 0)]  # an unknown goal
    # The same goal again.
    assert not desk.send(1, 1) and goals == [1, 2, 3, 4, 5]
    assert len(desk.server.goals) == 1


def test_two_goals_at_once() -> None:
    desk = ServerDesk(counting)
    assert desk.send(1, 3)
    desk.run(50)
    assert desk.send(2, 2)
    desk.ask_result(1)
    desk.ask_result(2)
    desk.run(500)
    assert desk.feedback() == [(1, 0), (2, 0), (1, 1), (2, 1), (1, 2)]
    assert desk.results() == [(4, 4, 2), (3, 4, 3)]


def test_steps_of_goals_take_turns() -> None:
    order = []

    def execute(goal):
        for _ in range(3):
            order.append(goal.request.n)
            yield
        goal.succeed()
        return Count.Result()

    begun = []
    desk = ServerDesk(execute, handle_accepted_callback=begun.append)
    for n in (1, 2, 3):
        assert desk.send(n, n)
    for goal in begun:
        goal.execute()
    desk.run(5)
    assert order == [1, 2, 3] * 3 and not desk.errors


def test_an_accepted_goal_begins_when_the_program_executes_it() -> None:
    held = []
    desk = ServerDesk(counting, handle_accepted_callback=held.append)
    assert desk.send(1, 1)
    desk.run(300)
    assert desk.states() == [[(1, 1)]] and desk.feedback() == []
    (goal,) = held
    assert goal.status == GoalStatus.STATUS_ACCEPTED and goal.is_active
    goal.execute()
    desk.run(300)
    assert desk.states() == [[(1, 2)], [(1, 4)]] and desk.feedback() == [(1, 0)]


def test_another_execute_callback_for_one_goal() -> None:
    def short_callback(goal):
        goal.succeed()
        return Count.Result(99)

    desk = ServerDesk(counting, handle_accepted_callback=lambda goal: goal.execute(short_callback))
    assert desk.send(1)
    desk.ask_result(1)
    assert desk.results() == [(2, 4, 99)]


def test_without_an_execute_callback_the_program_ends_goals() -> None:
    desk = ServerDesk(cancel_callback=lambda goal: CancelResponse.ACCEPT)
    for n in (1, 2, 3, 4):
        assert desk.send(n)
        desk.ask_result(n)
    first, two, three, four = desk.server.goals
    assert first.status == GoalStatus.STATUS_EXECUTING
    result = Count.Result(11)
    first.succeed(result)
    result.n = 12  # too late
    two.abort(Count.Result(22))
    assert desk.cancel(3) == (0, [3])
    three.canceled(Count.Result(33))
    four.succeed()
    desk.run(1)
    assert desk.results() == [(2, 4, 11), (4, 6, 22), (6, 5, 33), (8, 4, 0)]
    desk.run(1000)
    assert not desk.errors


def test_invalid_transitions_raise() -> None:
    desk = ServerDesk(
        handle_accepted_callback=lambda goal: None,
        cancel_callback=lambda goal: CancelResponse.ACCEPT,
    )
    assert desk.send(1)
    (goal,) = desk.server.goals
    for call in (goal.succeed, goal.abort, goal.canceled):
        assert "accepted cannot become" in raised(RuntimeError, call)
    goal.execute()
    assert "executing cannot become canceled" in raised(RuntimeError, goal.canceled)
    assert desk.cancel(1) == (0, [1])
    goal.canceled()
    for call in (goal.succeed, goal.abort, goal.canceled):
        assert "canceled cannot become" in raised(RuntimeError, call)
    assert desk.states() == [[(1, 1)], [(1, 2)], [(1, 3)], [(1, 5)]]


def test_a_goal_canceled_before_it_begins() -> None:
    desk = ServerDesk(
        counting, handle_accepted_callback=lambda goal: None,
        cancel_callback=lambda goal: CancelResponse.ACCEPT,
    )  # fmt: skip
    assert desk.send(1)
    assert desk.cancel(1) == (0, [1])
    desk.server.goals[0].execute()
    desk.ask_result(1)
    assert desk.results() == [(3, 5, 0)]
    assert desk.states() == [[(1, 1)], [(1, 3)], [(1, 5)]]


def test_an_execute_callback_that_fails_aborts_its_goal_only() -> None:
    def execute(goal):
        if goal.request.n == 1:
            raise ValueError("one")
        yield 0.01
        if goal.request.n == 2:
            raise ValueError("two")
        if goal.request.n == 3:
            return Count.Result(3)  # without succeed()
        if goal.request.n == 4:
            goal.succeed()
            raise ValueError("four")
        goal.succeed()
        if goal.request.n == 5:
            return Count.Goal(5)
        if goal.request.n == 6:
            return 6
        return Count.Result(7)

    desk = ServerDesk(execute)
    for n in (1, 2, 3, 4, 5, 6, 7):
        assert desk.send(n, n)
        desk.ask_result(n)
    desk.run(100)
    assert sorted(desk.results()) == [
        (2, 6, 0), (4, 6, 0), (6, 6, 3), (8, 4, 0), (10, 4, 0), (12, 4, 0), (14, 4, 7),
    ]  # fmt: skip
    texts = sorted([str(error) for error in desk.errors])
    assert [text for text in texts if "/" not in text] == ["four", "one", "two"], texts
    assert [text for text in texts if "counts as aborted" in text and text.startswith("/count: ")]
    assert [text for text in texts if "Count_Result, not test_msgs/action/Count_Goal" in text]
    assert [text for text in texts if "Count_Result, not int" in text]
    assert len(texts) == 6
    assert desk.node.executor.failed == 6


def test_messages_of_other_types_are_refused_as_feedback_or_result() -> None:
    desk = ServerDesk()
    assert desk.send(1)
    (goal,) = desk.server.goals
    assert "Count_Feedback" in raised(TypeError, goal.publish_feedback, Count.Result())
    assert "Count_Feedback" in raised(TypeError, goal.publish_feedback, 5)
    assert "Count_Result" in raised(TypeError, goal.succeed, Count.Feedback())
    raised(TypeError, goal.succeed, Count.Result("text"))  # the error of packing
    assert goal.is_active
    goal.succeed(Count.Result(1))


def test_a_generator_waits_for_a_future() -> None:
    future, failing = Future(), Future()
    caught = []

    def execute(goal):
        result = yield future
        try:
            yield failing
        except OSError as error:
            caught.append(str(error))
        goal.succeed()
        return Count.Result(result)

    desk = ServerDesk(execute)
    assert desk.send(1)
    desk.ask_result(1)
    desk.run(100)
    assert desk.results() == []
    future.finish(77)
    desk.run(100)
    assert desk.results() == []
    failing.finish(None, OSError("no"))
    desk.run(10)
    assert desk.results() == [(2, 4, 77)] and caught == ["no"]


async def count_async(goal):
    for i in range(goal.request.n):
        goal.publish_feedback(Count.Feedback(i))
        await Wait(0.1)
    goal.succeed()
    return Count.Result(goal.request.n)


def test_a_coroutine_executes_a_goal() -> None:
    desk = ServerDesk(count_async)
    assert desk.send(1, 2)
    desk.ask_result(1)
    desk.run(150)
    assert desk.results() == []
    desk.run(100)
    assert desk.results() == [(2, 4, 2)] and desk.feedback() == [(1, 0), (1, 1)]


def test_a_coroutine_waits_for_a_future() -> None:
    answer = Future()

    async def work(goal):
        n = await Wait(answer)
        goal.succeed()
        return Count.Result(n)

    desk = ServerDesk(work)
    assert desk.send(1)
    desk.ask_result(1)
    desk.run(100)
    assert desk.results() == []
    answer.finish(77)
    desk.run(20)
    assert desk.results() == [(2, 4, 77)] and desk.errors == []


def test_the_node_does_not_spin_while_work_pauses() -> None:
    def execute(goal):
        yield 10
        goal.succeed()
        return Count.Result()

    desk = ServerDesk(execute)
    assert desk.send(1)
    assert 9000 < desk.node.executor.wait(desk.clock.ms()) <= 10000


# --- canceling ----------------------------------------------------------------------------------


def test_cancel_by_id() -> None:
    desk = ServerDesk(counting, cancel_callback=lambda goal: CancelResponse.ACCEPT)
    assert desk.send(1, 30) and desk.send(2, 30)
    desk.states()
    assert desk.cancel(9) == (2, [])
    assert desk.cancel(1) == (0, [1])
    assert desk.states()[0] == [(1, 3), (2, 2)]
    assert desk.cancel(1) == (3, [])  # it is being canceled already
    desk.ask_result(1)
    desk.run(200)
    assert desk.results() == [(6, 5, 1)]
    assert desk.cancel(1) == (3, [])
    assert desk.server.goals[1].status == GoalStatus.STATUS_EXECUTING


def test_cancel_all_and_by_time() -> None:
    desk = ServerDesk(cancel_callback=lambda goal: CancelResponse.ACCEPT)
    for n in (1, 2, 3, 4, 5):
        assert desk.send(n)
        desk.run(20)
    stamps = [goal._goal_status.goal_info.stamp for goal in desk.server.goals]
    assert desk.cancel(None, stamps[1].sec, stamps[1].nanosec) == (0, [1, 2])
    # With an id and a time: the goal of the id, and goals accepted until then.
    assert desk.cancel(4, stamps[2].sec, stamps[2].nanosec) == (0, [3, 4])
    desk.server.goals[0].canceled()
    assert desk.cancel(None) == (0, [5])
    assert desk.cancel(None) == (0, [])
    assert desk.cancel(None, 1) == (0, [])  # older than all


def test_cancel_may_be_refused() -> None:
    answers = {1: CancelResponse.REJECT, 2: None, 3: True, 4: CancelResponse.ACCEPT}

    def cancel_callback(goal):
        n = goal.request.n
        if n == 5:
            raise ValueError("five")
        if n == 6:
            goal.succeed()  # just in time
            return CancelResponse.ACCEPT
        return answers[n]

    desk = ServerDesk(cancel_callback=cancel_callback)
    for n in (1, 2, 3, 4, 5, 6):
        assert desk.send(n, n)
    assert desk.cancel(1) == (1, [])
    assert desk.cancel(5) == (1, [])
    assert desk.cancel(None) == (0, [4])
    assert [str(error) for error in desk.errors] == ["five", "five"]
    desk = ServerDesk()
    assert desk.send(1)
    assert desk.cancel(1) == (1, [])  # without a callback nothing is canceled


# --- results are kept, and expire -----------------------------------------------------------------


def test_results_expire() -> None:
    desk = ServerDesk(result_timeout=2)
    assert desk.send(1) and desk.send(2)
    desk.server.goals[0].succeed(Count.Result(5))
    desk.states()
    desk.run(1900)
    desk.ask_result(1)
    assert desk.results() == [(3, 4, 5)]
    desk.run(200)
    desk.ask_result(1)
    assert desk.results() == [(4, 0, 0)]
    assert desk.states() == [[(2, 2)]]
    assert len(desk.server.goals) == 1  # an active goal does not expire
    desk.run(10000)
    assert len(desk.server.goals) == 1


def test_results_may_be_kept_for_ever_or_not_at_all() -> None:
    desk = ServerDesk(result_timeout=-1)
    assert desk.send(1)
    desk.server.goals[0].succeed(Count.Result(5))
    for _ in range(100):
        desk.run(10000)
    desk.ask_result(1)
    assert desk.results() == [(2, 4, 5)]
    desk = ServerDesk(result_timeout=0)
    assert desk.send(1)
    desk.ask_result(1)
    desk.server.goals[0].succeed(Count.Result(5))
    desk.run(10)
    assert desk.results() == [(2, 4, 5)]  # reply to the earlier request
    desk.ask_result(1)
    assert desk.results() == [(3, 0, 0)]


def test_max_goals_limits_the_goals() -> None:
    desk = ServerDesk(max_goals=2)
    assert desk.send(1) and desk.send(2)
    assert not desk.send(3)
    desk.server.goals[1].succeed(Count.Result(22))
    assert desk.send(4)  # the result of 2 goes early
    assert [goal.goal_id.uuid[0] for goal in desk.server.goals] == [1, 4]
    desk.ask_result(2)
    assert desk.results() == [(5, 0, 0)]


def test_pending_requests_for_a_result_are_limited() -> None:
    desk = ServerDesk()
    assert desk.send(1)
    for _ in range(20):
        desk.ask_result(1)
    desk.server.goals[0].succeed()
    desk.run(5)
    assert [identity for identity, _, _ in desk.results()] == [14, 15, 16, 17, 18, 19, 20, 21]


def test_a_result_over_the_limit_is_answered_by_an_empty_one() -> None:
    class Long(Record):
        _TYPE = "test_msgs/action/Count_Result"
        FIELDS = (("octets", 16),)  # as many as the value has

    desk = ServerDesk()
    assert desk.send(1)
    desk.ask_result(1)
    desk.server.goals[0].succeed(Long(bytes(40000)))
    desk.run(5)
    assert desk.results() == [(2, 0, 0)]
    assert len(desk.errors) == 1 and "limit" in str(desk.errors[0])


# --- bad requests, lost sessions, ends ----------------------------------------------------------


def test_malformed_requests_are_counted() -> None:
    desk = ServerDesk(counting)
    for object_id in (SEND_GOAL, CANCEL_GOAL, GET_RESULT):
        desk.agent.sample(object_id, bytes(10))
        desk.agent.sample(object_id, bytes(24))
    desk.run(20)
    assert [part.malformed for part in desk.server.parts[:3]] == [2, 2, 1]
    assert desk.send(1)


def test_a_server_continues_goals_without_an_agent() -> None:
    desk = ServerDesk(counting)
    assert desk.send(1, 3)
    desk.ask_result(1)
    desk.lose()
    desk.agent.silent = True
    desk.run(20000)  # the goal ends; without an agent its result does not expire
    desk.agent.silent = False
    assert desk.results() == []  # the request was of the last session
    (goal,) = desk.server.goals
    assert goal.status == GoalStatus.STATUS_SUCCEEDED
    desk.until(AGENT_CONNECTED)
    desk.run(10)
    assert desk.states() == [[(1, 4)]]  # a new agent gets the states at once
    desk.ask_result(1)
    assert desk.results() == [(3, 4, 3)]
    # The result_timeout begins when the result can be requested.
    desk.lose()
    desk.agent.silent = True
    desk.run(60000)
    assert len(desk.server.goals) == 1
    desk.agent.silent = False
    desk.until(AGENT_CONNECTED)
    desk.run(20000)
    assert len(desk.server.goals) == 0


def test_a_full_window_delays_replies_and_loses_none() -> None:
    desk = ServerDesk(max_goals=100)
    for n in range(1, 40):
        assert desk.send(n)
        desk.ask_result(n)
    desk.states()
    desk.node.connection.limit = 1200  # a little more than the states take
    before = len(desk.agent.sent)
    desk.agent.silent = True
    for goal in desk.server.goals:
        goal.succeed(Count.Result(7))
    desk.run(300)
    desk.agent.silent = False
    for datagram in desk.agent.sent[before:]:
        desk.agent.hear(datagram)
    desk.run(3000)
    assert len(desk.results()) == 39
    assert desk.states()[-1] == [(n, 4) for n in range(1, 40)]


def test_a_reply_without_room_is_sent_when_there_is_room() -> None:
    desk = ServerDesk()
    assert desk.send(1)
    desk.ask_result(1)
    (goal,) = desk.server.goals
    before = len(desk.agent.sent)
    desk.agent.silent = True
    desk.node.connection.limit = 200
    while goal.publish_feedback(Count.Feedback(1)):
        pass
    goal.succeed(Count.Result(7))
    desk.run(100)
    desk.agent.silent = False
    for datagram in desk.agent.sent[before:]:
        desk.agent.hear(datagram)
    desk.run(1000)
    assert desk.results() == [(2, 4, 7)] and desk.states()[-1] == [(1, 4)]


def test_a_reply_without_memory_is_sent_when_there_is_memory() -> None:
    desk = ServerDesk()
    write = desk.node.connection.write
    left = [2]

    def starving(*arguments):
        left[0] -= 1
        if left[0] >= 0:
            raise MemoryError
        return write(*arguments)

    desk.node.connection.write = starving
    assert desk.send(1) and left[0] < 0  # no other answer, such as an empty one: it is accepted
    assert [goal.goal_id.uuid for goal in desk.server.goals] == [uuid(1)]


def test_a_failed_creation_leaves_no_entities() -> None:
    for make in (
        lambda node: ActionServer(node, Count, "c", feedback_pub_qos_profile=-1),
        lambda node: ActionServer(node, Count, "c", status_pub_qos_profile=-1),
        lambda node: ActionClient(node, Count, "c", feedback_sub_qos_profile=-1),
        lambda node: ActionClient(node, Count, "c", status_sub_qos_profile=-1),
    ):
        desk = Desk()
        desk.until(AGENT_CONNECTED)
        try:
            make(desk.node)
        except ValueError as error:
            assert "depth" in str(error)
        else:
            raise AssertionError("not refused")
        connection = desk.node.connection
        assert connection._entities == [desk.node]
        assert not desk.node.executor.handles and not desk.node._entities
        desk.run(50)
        desk.lose()
        desk.until(AGENT_CONNECTED)
        assert desk.errors == []


def test_destroy_deletes_all_entities() -> None:
    closed = []

    def execute(goal):
        try:
            yield 100
        finally:
            closed.append(goal.request.n)

    desk = ServerDesk(execute)
    assert desk.send(1, 5)
    desk.agent.requests = []
    desk.server.destroy()
    desk.run(10)
    deleted = [object_id for kind, object_id in desk.agent.requests if kind == ids.DELETE]
    assert SEND_GOAL in deleted and STATUS in deleted and len(deleted) == 9
    assert closed == [5]
    assert desk.node.executor.handles == [] and desk.server.goals == []
    desk.node.destroy_node()


def test_an_action_is_one_handle_and_a_refused_one_leaves_no_entities() -> None:
    desk = Desk()
    assert "topic" in raised(ValueError, ActionServer, desk.node, Count, "a b")
    assert "topic" in raised(ValueError, ActionClient, desk.node, Count, "1")
    assert desk.node.executor.handles == []
    desk.node.executor.max_handles = 2
    ActionServer(desk.node, Count, "one")
    ActionClient(desk.node, Count, "two")
    assert len(desk.node.executor.handles) == 2
    before = len(desk.node.connection._entities)
    raised(ValueError, ActionServer, desk.node, Count, "three")
    assert len(desk.node.connection._entities) == before
    desk.until(AGENT_CONNECTED)
    desk.node.destroy_node()


# --- the client ---------------------------------------------------------------------------------


class ClientDesk(Desk):
    """An action client; the test is its server."""

    def __init__(self, connect=True):
        super().__init__()
        self.client = ActionClient(self.node, Count, "count")
        self.futures = []
        self.heard = []
        if connect:
            self.until(AGENT_CONNECTED)

    def requests(self, object_id, kind):
        """Return the requests since the last call."""
        self.run(1)
        return self.take(object_id, kind)

    def answer(self, object_id, number, response):
        self.agent.sample(object_id, number.to_bytes(2, "big") + bytes(2) + octets_of(response))
        self.run(1)

    def last_request(self):
        """Return the request id of the last WRITE_DATA."""
        sent = [datagram for datagram in self.agent.sent if datagram[4] == ids.WRITE_DATA]
        return sent[-1][8] << 8 | sent[-1][9]

    def send(self, n, accepted=True, sec=5):
        """Send a goal, answer the request, and return the goal handle."""
        future = self.client.send_goal_async(
            Count.Goal(n), lambda message: self.heard.append((n, message.feedback.n)), UUID(uuid(n))
        )
        number = self.last_request()
        (request,) = self.requests(ASK_GOAL, SendGoal.Request)
        assert request.goal_id.uuid == uuid(n) and request.goal.n == n
        assert not future.done()
        self.answer(ASK_GOAL, number, SendGoal.Response(accepted, Time(sec, 6)))
        assert future.done()
        return future.result()

    def feed(self, n, value):
        self.agent.sample(
            HEAR_FEEDBACK, octets_of(FeedbackMessage(UUID(uuid(n)), Count.Feedback(value)))
        )

    def say(self, *states):
        self.agent.sample(
            HEAR_STATUS,
            octets_of(
                StatusArray([Status(GoalInfo(UUID(uuid(n))), status) for n, status in states])
            ),
        )
        self.run(1)


def test_a_client_sends_a_goal_and_gets_the_result() -> None:
    desk = ClientDesk()
    goal = desk.send(3)
    assert goal.accepted and (goal.stamp.sec, goal.stamp.nanosec) == (5, 6)
    assert goal.status == GoalStatus.STATUS_ACCEPTED
    future = goal.get_result_async()
    number = desk.last_request()
    (request,) = desk.requests(ASK_RESULT, GetResult.Request)
    assert request.goal_id.uuid == uuid(3)
    desk.say((3, 2), (9, 4))
    assert goal.status == GoalStatus.STATUS_EXECUTING
    for value in range(3):
        desk.feed(3, value)
    desk.feed(9, 100)  # feedback of another client's goal
    order = []
    future.add_done_callback(lambda future: order.append(list(desk.heard)))
    desk.answer(ASK_RESULT, number, GetResult.Response(4, Count.Result(33)))
    desk.run(5)
    assert desk.heard == [(3, 0), (3, 1), (3, 2)]
    assert order == [desk.heard]  # feedback received before the result is passed on before it
    assert (future.result().status, future.result().result.n) == (4, 33)
    assert goal.status == GoalStatus.STATUS_SUCCEEDED
    desk.feed(3, 4)
    desk.run(5)
    assert len(desk.heard) == 3 and not desk.client._goals and not desk.errors


def test_feedback_received_before_the_result_is_passed_on_first() -> None:
    desk = ClientDesk()
    goal = desk.send(3)
    future = goal.get_result_async()
    number = desk.last_request()
    desk.run(1)
    desk.feed(3, 1)
    desk.feed(3, 2)
    answer = octets_of(GetResult.Response(4, Count.Result(33)))
    desk.agent.sample(ASK_RESULT, number.to_bytes(2, "big") + bytes(2) + answer)
    for _ in range(10):  # all are received before the first callback
        desk.node.connection.pump(0)
    assert desk.heard == []
    order = []
    future.add_done_callback(lambda future: order.append(len(desk.heard)))
    desk.run(5)
    assert order == [2]


def test_feedback_after_the_final_status_is_passed_on_until_the_result() -> None:
    desk = ClientDesk()
    goal = desk.send(3)
    goal.get_result_async()
    desk.run(1)
    desk.say((3, 4))
    desk.feed(3, 1)
    desk.run(5)
    assert desk.heard == [(3, 1)] and goal.status == GoalStatus.STATUS_SUCCEEDED


def test_a_rejected_goal_receives_no_feedback() -> None:
    desk = ClientDesk()
    goal = desk.send(3, accepted=False)
    assert not goal.accepted and goal.status == GoalStatus.STATUS_UNKNOWN
    desk.feed(3, 1)
    desk.run(5)
    assert desk.heard == [] and not desk.client._goals


def test_each_goal_has_a_random_uuid() -> None:
    desk = ClientDesk()
    desk.client.send_goal_async(Count.Goal(1))
    desk.client.send_goal_async(Count.Goal(2))
    first, two = desk.requests(ASK_GOAL, SendGoal.Request)
    assert len(first.goal_id.uuid) == 16 and first.goal_id.uuid != two.goal_id.uuid
    assert len(random_uuid()) == 16


def test_canceling_by_a_client() -> None:
    desk = ClientDesk()
    goal = desk.send(3)
    for call, n, stamp in (
        (goal.cancel_goal_async, 3, (0, 0)),
        (desk.client.cancel_all_goals_async, 0, (0, 0)),
        (lambda: desk.client.cancel_goals_before_async(Time(7, 8)), 0, (7, 8)),
    ):
        future = call()
        number = desk.last_request()
        (request,) = desk.requests(ASK_CANCEL, Cancel.Request)
        info = request.goal_info
        assert info.goal_id.uuid == uuid(n) and (info.stamp.sec, info.stamp.nanosec) == stamp
        desk.answer(ASK_CANCEL, number, Cancel.Response(0, [GoalInfo(UUID(uuid(3)))]))
        assert future.result().return_code == 0
        assert future.result().goals_canceling[0].goal_id.uuid == uuid(3)
    desk.say((3, 3))
    assert goal.status == GoalStatus.STATUS_CANCELING
    desk.say((3, 5))
    assert goal.status == GoalStatus.STATUS_CANCELED and not desk.client._goals


def test_send_goal_refuses_messages_of_other_types() -> None:
    desk = ClientDesk()
    assert "Count_Goal" in raised(TypeError, desk.client.send_goal_async, Count.Result(1))
    assert "Count_Goal" in raised(TypeError, desk.client.send_goal_async, 5)
    raised(TypeError, desk.client.send_goal_async, Count.Goal("text"))
    assert not desk.client._goals


def test_without_a_session_nothing_is_sent() -> None:
    desk = ClientDesk(connect=False)
    assert not desk.client.server_is_ready()
    future = desk.client.send_goal_async(Count.Goal(1))
    assert "cannot be asked" in raised(OSError, future.result)
    assert not desk.client.wait_for_server(0.0)
    assert desk.client.wait_for_server(5.0) and desk.client.server_is_ready()
    desk = ClientDesk(connect=False)
    assert desk.client.wait_for_server()


def test_a_client_that_is_ready_can_send_a_goal() -> None:
    desk = ClientDesk(connect=False)
    requested = 0  # rounds in which all parts were requested, but the node was not connected yet
    while not desk.client.server_is_ready():
        if not [part for part in desk.client.parts if not part.created]:
            requested += 1
            assert desk.client.send_goal_async(Count.Goal(1)).exception() is not None
        desk.node.spin_once(0.01)
        assert desk.clock.t < 60000000
    assert requested and desk.node.state == AGENT_CONNECTED
    assert desk.send(1).accepted
    # The node is connected, and the parts of another client are still to be created.
    other = ActionClient(desk.node, Count, "other")
    assert not other.server_is_ready() and desk.client.server_is_ready()
    assert other.wait_for_server(5.0)
    assert not other.send_goal_async(Count.Goal(1)).done()
    desk.lose()
    assert not desk.client.server_is_ready()


def test_the_end_of_a_session_fails_pending_futures() -> None:
    desk = ClientDesk()
    goal = desk.send(1)
    futures = [
        desk.client.send_goal_async(Count.Goal(2)), goal.get_result_async(),
        goal.cancel_goal_async(),
    ]  # fmt: skip
    desk.run(5)
    assert not [future for future in futures if future.done()]
    desk.lose()
    desk.run(5)
    for future in futures:
        assert ": lost" in raised(OSError, future.result)
    assert goal.get_result_async().exception() is not None
    # The goal continues at its server, and feedback is received again.
    desk.until(AGENT_CONNECTED)
    desk.feed(1, 5)
    desk.say((1, 2))
    desk.run(5)
    assert desk.heard == [(1, 5)] and goal.status == GoalStatus.STATUS_EXECUTING
    future = goal.get_result_async()
    desk.answer(ASK_RESULT, desk.last_request(), GetResult.Response(6, Count.Result(1)))
    assert future.result().status == 6 and goal.status == GoalStatus.STATUS_ABORTED
    assert not desk.client._goals


def test_a_goal_that_ends_before_it_is_accepted() -> None:
    """Topics and services have no common order."""
    desk = ClientDesk()
    future = desk.client.send_goal_async(Count.Goal(3), None, UUID(uuid(3)))
    number = desk.last_request()
    desk.run(1)
    desk.say((3, 4))
    desk.answer(ASK_GOAL, number, SendGoal.Response(True))
    goal = future.result()
    assert goal.accepted and goal.status == GoalStatus.STATUS_SUCCEEDED
    assert not desk.client._goals
    future = goal.get_result_async()
    desk.answer(ASK_RESULT, desk.last_request(), GetResult.Response(4, Count.Result(1)))
    assert future.result().result.n == 1 and not desk.client._goals


def test_the_result_of_an_unknown_goal_is_status_unknown() -> None:
    desk = ClientDesk()
    goal = desk.send(1)
    future = goal.get_result_async()
    desk.answer(ASK_RESULT, desk.last_request(), GetResult.Response(0))
    assert future.result().status == GoalStatus.STATUS_UNKNOWN
    assert goal.status == GoalStatus.STATUS_ACCEPTED  # the last status received


def test_remove_pending_request_drops_requests() -> None:
    desk = ClientDesk()
    goal = desk.send(1)
    sent = desk.client.send_goal_async(Count.Goal(2))
    number = desk.last_request()
    asked = goal.get_result_async()
    desk.run(5)
    for future in (sent, asked):
        desk.client.remove_pending_request(future)
    assert list(desk.client._goals) == [uuid(1)]
    desk.answer(ASK_GOAL, number, SendGoal.Response(True))
    assert not sent.done()


def test_destroying_a_client_fails_its_futures() -> None:
    desk = ClientDesk()
    goal = desk.send(1)
    waiting = [desk.client.send_goal_async(Count.Goal(2)), goal.get_result_async()]
    desk.client.destroy()
    for future in waiting:
        assert isinstance(future.exception(), OSError)
    desk.run(10)
    assert desk.node.executor.handles == [] and not desk.errors


def test_feedback_callbacks_that_raise_are_reported() -> None:
    desk = ClientDesk()

    def fail(message):
        raise ValueError("feedback")

    future = desk.client.send_goal_async(Count.Goal(1), fail, UUID(uuid(1)))
    desk.run(1)
    desk.answer(ASK_GOAL, desk.last_request(), SendGoal.Response(True))
    assert future.result().accepted
    desk.feed(1, 1)
    desk.feed(1, 2)
    desk.run(5)
    assert [str(error) for error in desk.errors] == ["feedback", "feedback"]
