from types import SimpleNamespace

from uros.tools.topic import lost


def test_losses_are_told_once_a_second_and_at_the_end(monkeypatch, capsys):
    now = [10.0]
    monkeypatch.setattr(lost.time, "monotonic", lambda: now[0])
    network = SimpleNamespace(lost=lambda: count, overflowed=False)
    count = 0
    report = lost.LostReport(network)

    def told(**options):
        report.tell(**options)
        return capsys.readouterr().err

    assert told() == ""
    count = 3
    assert told() == "WARNING: 3 messages were lost or skipped, 3 in all\n"
    count = 5
    assert told() == ""
    now[0] += 1.0
    assert told(skipped=2) == "WARNING: 4 messages were lost or skipped, 7 in all\n"
    count = 6
    assert told(skipped=2, last=True) == "WARNING: 1 messages were lost or skipped, 8 in all\n"
    assert told(skipped=2, last=True) == ""
    network.overflowed = True
    assert told(skipped=2, last=True) == (
        "WARNING: 0 messages were lost or skipped, 8 in all; some more, as the queue of --qos-depth"
        " messages was full\n"
    )
    assert told(skipped=2, last=True) == ""
