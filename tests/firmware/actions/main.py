"""A board that serves an action, and uses one where it is told to.

config.py beside it has NAME, the node's, and PEER, the action that it uses.
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
    told = node.create_publisher(String, "told", 100)

    def tell(number, what, sequence=()):
        words = [number, what] + [str(it) for it in sequence]
        told.publish(String(" ".join(words)))

    def send(message):
        """``number order [cancel_at]``: cancel when the sequence is so long."""
        number, order, cancel_at = message.data.split()
        handles = []

        def feedback(message):
            sequence = message.feedback.sequence
            tell(number, "feedback", sequence)
            if len(sequence) == int(cancel_at):
                handles[0].cancel_goal_async().add_done_callback(canceled)

        def canceled(future):
            answer = future.result()
            tell(number, "cancel %d" % answer.return_code, [len(answer.goals_canceling)])

        def accepted(future):
            try:
                goal = future.result()
            except OSError:
                print(number, "lost")
                return
            tell(number, "accepted" if goal.accepted else "refused")
            if goal.accepted:
                handles.append(goal)
                goal.get_result_async().add_done_callback(ended)

        def ended(future):
            try:
                answer = future.result()
            except OSError:
                print(number, "lost")
                return
            tell(number, "result %d" % answer.status, answer.result.sequence)

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
