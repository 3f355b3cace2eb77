"""peer.py with actions: what a real rclpy node has to do with those of boards."""

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
        self.goals = {}  # by the test's name for it: what came of it
        self.servers = []
        self.stopped = False

    # --- as a client ----------------------------------------------------------------

    def client(self, name, seconds):
        """A client that has got answers of all three services.

        That it has discovered them does not say that they have discovered it, and then their
        answers go nowhere.
        """
        if name in self.clients:
            return self.clients[name]
        client = ActionClient(self.node, Fibonacci, name)
        assert self.wait(seconds, client.server_is_ready), f"{name} is not there"
        goal = self.ask(seconds, lambda: client.send_goal_async(Fibonacci.Goal(order=1)))
        assert goal is not None and goal.accepted
        assert self.ask(seconds, goal.get_result_async) is not None
        assert self.ask(seconds, goal.cancel_goal_async) is not None
        self.clients[name] = client
        return client

    def ask(self, seconds, call):
        """What the future that ``call`` returns comes to; it is called again where that takes too
        long."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            future = call()
            if self.wait(ASK_AGAIN, future.done):
                return future.result()
        return None

    def do_send(self, name, goals, seconds=15):
        """Send goals (the test's name → order, cancel_at) at once, and wait for all results.

        Cancel when the feedback is so long; the answer to that is in ``cancel``.
        """
        client = self.client(name, seconds)
        for key, (order, cancel_at) in goals.items():
            self.goals[key] = self.send(client, order, cancel_at)
        self.wait(seconds, lambda: all("end" in self.goals[key] for key in goals))
        return {"goals": {key: self.shown(key) for key in goals}}

    def shown(self, key):
        return {name: it for name, it in self.goals[key].items() if name not in ("handle", "id")}

    def send(self, client, order, cancel_at):
        state = {"feedback": []}
        asked = []

        def feedback(message):
            sequence = list(message.feedback.sequence)
            state["feedback"].append(sequence)
            # Not exactly then: the first of the feedback may come before we are met.
            if 0 < cancel_at <= len(sequence) and "handle" in state and not asked:
                asked.append(True)
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
        """Send goals as do_send, but wait until they are accepted only."""
        client = self.client(name, seconds)
        for key, (order, cancel_at) in goals.items():
            self.goals[key] = self.send(client, order, cancel_at)
        self.wait(seconds, lambda: all("accepted" in self.goals[key] for key in goals))
        return {"goals": {key: self.shown(key) for key in goals}}

    def do_end(self, goals, seconds=15):
        """Wait for the results of goals that were begun."""
        self.wait(seconds, lambda: all("end" in self.goals[key] for key in goals))
        return {"goals": {key: self.shown(key) for key in goals}}

    def do_result(self, key, status, seconds=15):
        """Ask for the result of a goal again until the status is this one; what was last said.

        What is asked before the server is known, or after it has left, gets no answer.
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
        """Cancel by the goal's id, and by the time that another one was accepted."""
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
        """Subscribe to the states of goals, and wait until these have that one, the last in what
        was said before or is said now; how many messages that took."""
        wanted = {bytes(self.goals[key]["handle"].goal_id.uuid) for key in keys}
        seen = []

        def heard(message):
            seen.append(
                {bytes(it.goal_info.goal_id.uuid) for it in message.status_list
                 if it.status == status}
            )  # fmt: skip

        qos = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        topic = name + "/_action/status"
        subscription = self.node.create_subscription(GoalStatusArray, topic, heard, qos)
        self.wait(seconds, lambda: seen and wanted <= seen[-1])
        self.node.destroy_subscription(subscription)
        return {"said": bool(seen) and wanted <= seen[-1], "count": len(seen)}

    # --- as a server ----------------------------------------------------------------

    def do_serve(self, name, seconds=15):
        """Serve the action: an order below 0 is refused, ABORTED is aborted, and STUBBORN is not
        canceled."""

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

        asked = self.asked = []

        def check(goal):
            asked.append(goal.order)
            return GoalResponse.REJECT if goal.order < 0 else GoalResponse.ACCEPT

        def cancel(goal):
            stubborn = goal.request.order == STUBBORN
            return CancelResponse.REJECT if stubborn else CancelResponse.ACCEPT

        self.stopped = False
        self.servers.append(
            ActionServer(
                self.node, Fibonacci, name, execute, goal_callback=check, cancel_callback=cancel
            )
        )
        return {}

    def do_stop(self, seconds=15):
        """Come to an end with all goals."""
        self.stopped = True
        return {"asked": self.asked}


if __name__ == "__main__":
    rclpy.init()
    try:
        ActionPeer().run()
    finally:
        rclpy.shutdown()
