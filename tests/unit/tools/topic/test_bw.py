from uros.host.network import Received
from uros.tools.topic.bw import Bandwidth, report

S = 1_000_000_000


def fed(*messages, window=100):
    """Return the bandwidth of messages, given by their time in seconds and their octets."""
    bandwidth = Bandwidth(window)
    for seconds, octets in messages:
        bandwidth.add(Received(bytes(octets), 0, 0), int(seconds * S))
    return bandwidth


def test_one_message_is_no_bandwidth():
    assert report({"/x": fed((0, 100))}, S, True) == ""
    assert report({"/x": fed((0, 100), (0, 100))}, 0, True) == ""


def test_the_output_is_that_of_ros2_in_the_unit_of_the_rate():
    assert report({"/x": fed((0, 100), (1, 300))}, 2 * S, True) == (
        "200 B/s from 2 messages\n\tMessage size mean: 200 B min: 100 B max: 300 B\n"
    )
    assert report({"/x": fed((0, 1000), (1, 3000))}, 2 * S, True) == (
        "2.00 KB/s from 2 messages\n\tMessage size mean: 2.00 KB min: 1.00 KB max: 3.00 KB\n"
    )
    assert report({"/x": fed((0, 10**6), (0.5, 10**6))}, S, True) == (
        "2.00 MB/s from 2 messages\n\tMessage size mean: 1.00 MB min: 1.00 MB max: 1.00 MB\n"
    )


def test_the_window_is_of_messages():
    usage = fed((0, 1), (1, 200), (2, 200), window=2).usage(3 * S)
    assert (usage.window, usage.smallest, usage.rate) == (2, 200, 200.0)


def test_the_bandwidth_of_a_topic_that_has_ended_falls():
    ended = fed((0, 100), (1, 100))
    assert ended.usage(2 * S).rate == 100 and ended.usage(20 * S).rate == 10
    ended.reset()
    assert ended.usage(20 * S) is None


def test_several_topics_are_a_table():
    meters = {"/x": fed((0, 100), (1, 100)), "/longer": fed((0, 9), (1, 9)), "/silent": fed()}
    head, line, x, longer, end, last = report(meters, 2 * S, False).split("\n")
    assert head.split() == ["topic", "bandwidth", "window", "mean", "min", "max"]
    assert set(line) == {"="}
    assert x.split() == ["/x", "100", "B/s", "2", "100", "B", "100", "B", "100", "B"]
    assert longer.split()[:3] == ["/longer", "9", "B/s"]
    assert (end, last) == ("", "")
