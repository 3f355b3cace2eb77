"""peer.py with actions: a real rclpy node as action client and action server for boards."""

import time

import rclpy
from action_msgs.msg import GoalStatusArray
from action_msgs.srv import CancelGoal
from peer import Peer
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from test_msgs.action import Fibonacci

PRIME = 1000000007  # sums stay within an int32
ABORTED = 3
STUBBORN = 13
ASK_AGAIN = 2.0


class ActionPeer(Peer):
    def __init__(self):
        super().__init__()
        self.clients = {}
        self.goals = {}  # the state of each goal, by the name that the test gave the goal
        self.servers = []
        self.stopped = False

    # --- as a client ----------------------------------------------------------------

    def client(self, name, seconds):
        """Return an action client that has received feedback, and a response of each service.

        A client that has discovered the services may itself not be discovered by them yet; their
        responses and the feedback are lost until then.
        """
        if name in self.clients:
            return self.clients[name]
        client = ActionClient(self.node, Fibonacci, name)
        assert self.wait(seconds, client.server_is_ready), f"{name} is not available"
        heard = []
        deadline = time.monotonic() + seconds
        while not heard:
            assert time.monotonic() < deadline, f"{name} gives no feedback"
            goal = self.ask(
                seconds, lambda: client.send_goal_async(Fibonacci.Goal(order=4), heard.append)
            )
            assert goal is not None and goal.accepted
            assert self.ask(seconds, goal.get_result_async) is not None
        assert self.ask(seconds, goal.cancel_goal_async) is not None
        self.clients[name] = client
        return client

    def ask(self, seconds, call):
        """Return the result of the future that ``call`` returns.

        ``call`` is repeated every ASK_AGAIN seconds without a result; None after ``seconds``.
        """
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            future = call()
            if self.wait(ASK_AGAIN, future.done):
                return future.result()
        return None

    def do_send(self, name, goals, seconds=15):
        """Send goals (the test's name → order, cancel_at) at once, and wait for all results.

        A goal is canceled when its feedback has ``cancel_at`` numbers; the response to the cancel
        request is in ``cancel``.
        """
        client = self.client(name, seconds)
        for key, (order, cancel_at) in goals.items():
            self.goals[key] = self.send(client, order, cancel_at)
        self.wait(seconds, lambda: all(map(self.has_ended, goals)))
        return {"goals": {key: self.shown(key) for key in goals}}

    def has_ended(self, key):
        """Whether a goal has its result, and the response to its cancel request if there is one."""
        state = self.goals[key]
        return "end" in state and ("cancel" in state or not state["cancels"])

    def shown(self, key):
        hidden = "handle", "id", "cancels"
        return {name: value for name, value in self.goals[key].items() if name not in hidden}

    def send(self, client, order, cancel_at):
        state = {"feedback": [], "cancels": []}

        def feedback(message):
            sequence = list(message.feedback.sequence)
            state["feedback"].append(sequence)
            # At or after cancel_at: the first feedback may come before the goal response.
            is_asked = bool(state["cancels"])
            if 0 < cancel_at <= len(sequence) and "handle" in state and not is_asked:
                state["cancels"].append(True)
                state["handle"].cancel_goal_async().add_done_callback(canceled)

        def canceled(future):
            answer = future.result()
            state["cancel"] = [answer.return_code, len(answer.goals_canceling)]

        def accepted(future):
            goal = state["handle"] = future.result()
            state["accepted"] = goal.accepted
            if goal.accepted:
                goal.get_result_async().add_done_callback(ended)
            else:
                state["end"] = None

        def ended(future):
            answer = future.result()
            state["end"] = [answer.status, list(answer.result.sequence)]

        client.send_goal_async(Fibonacci.Goal(order=order), feedback_callback=feedback)\
            .add_done_callback(accepted)  # fmt: skip
        return state

    def do_begin(self, name, goals, seconds=15):
        """Send goals as do_send does, but wait only until they are accepted."""
        client = self.client(name, seconds)
        for key, (order, cancel_at) in goals.items():
            self.goals[key] = self.send(client, order, cancel_at)
        self.wait(seconds, lambda: all("accepted" in self.goals[key] for key in goals))
        return {"goals": {key: self.shown(key) for key in goals}}

    def do_end(self, goals, seconds=15):
        """Wait for the results of goals that do_begin sent."""
        self.wait(seconds, lambda: all(map(self.has_ended, goals)))
        return {"goals": {key: self.shown(key) for key in goals}}

    def do_result(self, key, status, seconds=15):
        """Request the result of a goal until it has this status; return the last response.

        Requests before the server is discovered, or after it has left, get no response.
        """
        answers = []
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not (answers and answers[-1][0] == status):
            answer = self.ask(
                deadline - time.monotonic(), self.goals[key]["handle"].get_result_async
            )
            if answer is not None:
                answers.append([answer.status, list(answer.result.sequence)])
        return {"end": answers[-1] if answers else None}

    def do_cancel(self, name, key=None, before=None, seconds=15):
        """Cancel goal ``key`` by its id, and all goals accepted no later than goal ``before``."""
        client = self.node.create_client(CancelGoal, name + "/_action/cancel_goal")
        assert self.wait(seconds, client.service_is_ready)
        request = CancelGoal.Request()
        if key is not None:
            request.goal_info.goal_id = self.goals[key]["handle"].goal_id
        if before is not None:
            request.goal_info.stamp = self.goals[before]["handle"].stamp
        answer = self.ask(seconds, lambda: client.call_async(request))
        self.node.destroy_client(client)
        return {"code": answer.return_code, "count": len(answer.goals_canceling)}

    def do_watch(self, name, keys, status, seconds=15):
        """Subscribe to the status topic, and wait until the last message lists all these goals
        with this status; ``reached`` says whether it did, ``count`` how many messages came."""
        wanted = {bytes(self.goals[key]["handle"].goal_id.uuid) for key in keys}
        matching = []  # for each message, the ids of its goals with this status

        def heard(message):
            matching.append(
                {bytes(goal.goal_info.goal_id.uuid) for goal in message.status_list
                 if goal.status == status}
            )  # fmt: skip

        qos = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        topic = name + "/_action/status"
        subscription = self.node.create_subscription(GoalStatusArray, topic, heard, qos)
        self.wait(seconds, lambda: matching and wanted <= matching[-1])
        self.node.destroy_subscription(subscription)
        reached = bool(matching) and wanted <= matching[-1]
        return {"reached": reached, "count": len(matching)}

    # --- as a server ----------------------------------------------------------------

    def do_serve(self, name, seconds=15):
        """Serve the action: goals with an order below 0 are rejected, order ABORTED is aborted,
        and a request to cancel order STUBBORN, or thousands more, is rejected."""

        def pause(time):
            future = Future(executor=self.executor)
            timer = self.node.create_timer(time, lambda: future.set_result(None))
            future.add_done_callback(lambda _: self.node.destroy_timer(timer))
            return future

        async def execute(goal):
            sequence = [0, 1]
            for i in range(1, goal.request.order):
                if self.stopped:
                    break
                if goal.is_cancel_requested:
                    goal.canceled()
                    return Fibonacci.Result(sequence=sequence)
                sequence.append((sequence[i] + sequence[i - 1]) % PRIME)
                goal.publish_feedback(Fibonacci.Feedback(sequence=sequence))
                await pause(0.05)
            if goal.request.order == ABORTED:
                goal.abort()
            else:
                goal.succeed()
            return Fibonacci.Result(sequence=sequence)

        orders = self.orders = []

        def check(goal):
            orders.append(goal.order)
            return GoalResponse.REJECT if goal.order < 0 else GoalResponse.ACCEPT

        def cancel(goal):
            stubborn = goal.request.order % 1000 == STUBBORN
            return CancelResponse.REJECT if stubborn else CancelResponse.ACCEPT

        self.stopped = False
        self.servers.append(
            ActionServer(
                self.node, Fibonacci, name, execute, goal_callback=check, cancel_callback=cancel
            )
        )
        return {}

    def do_stop(self, seconds=15):
        """End the execution of all goals; return the orders of all goals that were requested."""
        self.stopped = True
        return {"orders": self.orders}


if __name__ == "__main__":
    rclpy.init()
    try:
        ActionPeer().run()
    finally:
        rclpy.shutdown()
