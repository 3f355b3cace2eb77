"""A board with an action server, and an action client that the topic ``send`` controls.

config.py in the same folder has NAME, the name of the node, and PEER, the action of the client.
"""

from config import NAME, PEER
from std_msgs.msg import String
from test_msgs.action import Fibonacci

from uros.client import Node
from uros.client.action_client import ActionClient
from uros.client.action_server import ActionServer
from uros.client.actions import CancelResponse, GoalResponse
from uros.drivers.port import open_port
from uros.transport.serial import StreamTransport

PRIME = 1000000007  # sums stay within an int32
ABORTED = 3
STUBBORN = 13
FAILING = 14

node = None


def work(goal):
    order = goal.request.order
    sequence = [0, 1]
    for i in range(1, order):
        if goal.is_cancel_requested:
            goal.canceled()
            return Fibonacci.Result(sequence)
        sequence.append((sequence[i] + sequence[i - 1]) % PRIME)
        goal.publish_feedback(Fibonacci.Feedback(sequence))
        yield 0.05
    if order == FAILING:
        raise ValueError("order %d" % order)
    if order == ABORTED:
        goal.abort()
    else:
        goal.succeed()
    return Fibonacci.Result(sequence)


def start():
    global node
    port = open_port(0x045B, 0x2013, "Renesas", NAME, "000001")
    node = Node(NAME, StreamTransport(port), namespace=NAME)
    ActionServer(
        node, Fibonacci, "fibonacci", work,
        goal_callback=lambda goal: (
            GoalResponse.REJECT if goal.order < 0 else GoalResponse.ACCEPT
        ),
        cancel_callback=lambda goal: (
            CancelResponse.REJECT if goal.request.order == STUBBORN else CancelResponse.ACCEPT
        ),
        result_timeout=5,
    )  # fmt: skip
    client = ActionClient(node, Fibonacci, PEER)
    reports = node.create_publisher(String, "told", 100)

    def report_result(number, event, sequence=()):
        words = [number, event] + [str(value) for value in sequence]
        reports.publish(String(" ".join(words)))

    def send(message):
        """Send a goal: ``number order cancel_at``; cancel at a sequence of length ``cancel_at``."""
        number, order, cancel_at = message.data.split()
        handles = []

        def feedback(message):
            sequence = message.feedback.sequence
            report_result(number, "feedback", sequence)
            if len(sequence) == int(cancel_at):
                handles[0].cancel_goal_async().add_done_callback(canceled)

        def canceled(future):
            answer = future.result()
            report_result(number, "cancel %d" % answer.return_code, [len(answer.goals_canceling)])

        def accepted(future):
            try:
                goal = future.result()
            except OSError:
                print(number, "lost")
                return
            report_result(number, "accepted" if goal.accepted else "refused")
            if goal.accepted:
                handles.append(goal)
                goal.get_result_async().add_done_callback(ended)

        def ended(future):
            try:
                answer = future.result()
            except OSError:
                print(number, "lost")
                return
            report_result(number, "result %d" % answer.status, answer.result.sequence)

        goal = Fibonacci.Goal(int(order))
        client.send_goal_async(goal, feedback).add_done_callback(accepted)

    node.create_subscription(String, "send", send, 10)


def step():
    node.spin_once(0.1)


def main():
    start()
    while True:
        step()


if __name__ == "__main__":
    main()
