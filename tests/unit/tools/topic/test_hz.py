import pytest

from uros.tools.topic.hz import Rate, report

MS = 1_000_000


def fed(*times, window=10000):
    rate = Rate(window)
    for time in times:
        rate.add(time * MS)
    return rate


def test_one_message_is_no_rate():
    assert report({"/x": fed()}) == ""
    assert report({"/x": fed(0)}) == ""


def test_the_output_is_that_of_ros2():
    assert report({"/x": fed(0, 100, 210, 300)}) == (
        "average rate: 10.000\n\tmin: 0.090s max: 0.110s std dev: 0.00816s window: 3\n"
    )


def test_a_rate_without_new_messages_is_not_printed_again():
    rate = fed(0, 100)
    assert report({"/x": rate})
    assert report({"/x": rate}) == ""
    rate.add(200 * MS)
    assert report({"/x": rate})


def test_the_window():
    stats = fed(0, 1000, 1100, 1200, window=2).statistics()
    assert stats.window == 2 and stats.rate == pytest.approx(10)


def test_messages_at_one_instant():
    assert fed(5, 5).statistics().rate == 0.0


def test_several_topics_are_a_table():
    text = report({"/x": fed(0, 100), "/longer": fed(0, 50), "/silent": fed()})
    head, line, x, longer, end, last = text.split("\n")
    assert head.split() == ["topic", "rate", "min_delta", "max_delta", "std_dev", "window"]
    assert set(line) == {"="}
    assert x.split() == ["/x", "10.000", "0.100", "0.100", "0.00000", "1"]
    assert longer.split()[:2] == ["/longer", "20.000"]
    assert (end, last) == ("", "")
