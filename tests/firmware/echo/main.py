"""A board that publishes the messages it receives, and calls and serves a service.

config.py in the same folder has NAME, the name of the node, and PEER, that of the other board.
"""

from config import NAME, PEER
from geometry_msgs.msg import Twist
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Int32, String
from std_srvs.srv import Trigger

from uros.client import Node
from uros.drivers.port import open_port
from uros.transport.serial import StreamTransport

node = None
served = 0


def echo(type, name):
    publisher = node.create_publisher(type, name + "_back", 10)
    node.create_subscription(type, name, publisher.publish, 10)


def serve(request, response):
    global served
    served += 1
    response.success = served % 2 == 1
    response.message = "%s[%d]" % (NAME, served)
    return response


def start():
    global node, served
    served = 0
    port = open_port(0x045B, 0x2013, "Renesas", NAME, "000001")
    # A picture is longer than the default limit of a board.
    node = Node(NAME, StreamTransport(port), namespace=NAME, limit=65536)
    for type, name in (
        (Int32, "number"),
        (String, "text"),
        (Twist, "twist"),
        (CompressedImage, "picture"),
    ):
        echo(type, name)
    node.create_service(Trigger, "trigger", serve)
    client = node.create_client(Trigger, "/" + PEER + "/trigger")
    answers = node.create_publisher(String, "answers", 10)

    def on_response(future):
        response = future.result()
        answers.publish(String(data="%s %s" % (response.success, response.message)))

    def call():
        future = client.call_async(Trigger.Request())
        if future.done():
            return  # not connected
        future.add_done_callback(on_response)

    node.create_timer(0.2, call)


def step():
    node.spin_once(0.1)


def main():
    start()
    while True:
        step()


if __name__ == "__main__":
    main()
