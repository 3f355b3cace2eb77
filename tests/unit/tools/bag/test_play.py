import argparse
import gc
import signal
import sys

import pytest
from support.bag_network import STRING, Network, Writer

from uros.bag.metadata import TopicMetadata
from uros.bag.reader import BagReader
from uros.bag.writer import BagWriter
from uros.interfaces import load
from uros.interfaces.codec import from_cdr
from uros.qos import QoSProfile, ReliabilityPolicy
from uros.tools import cli
from uros.tools.bag import keyboard, play
from uros.tools.errors import UsageError

MS = 1_000_000
S = 10**9
BEGIN = 1_700_000_000 * S
CLOCK = load("rosgraph_msgs/msg/Clock")
BEST_EFFORT = QoSProfile(5, ReliabilityPolicy.BEST_EFFORT)


def sample(number):
    return b"\0\1\0\0" + bytes([number, 0, 0, 0])


def write(folder, topics=("/x",), times=range(5), storage="mcap", type_name=STRING):
    """Write a bag with a message on each topic at these times, in ms from BEGIN."""
    with BagWriter(folder, storage) as writer:
        numbers = [writer.add_topic(TopicMetadata(t, type_name, [BEST_EFFORT])) for t in topics]
        for number, time in enumerate(times):
            for topic in numbers:
                at = BEGIN + time * MS
                writer.write(topic, sample(number), at, at)
    return folder


@pytest.fixture
def network():
    return Network()


@pytest.fixture
def run(monkeypatch, capsys, network):
    """Plays bags on a network; returns status, output and errors."""

    def run(*options):
        monkeypatch.setattr(play, "join", lambda args, node_name: network)
        status = cli.main(["bag", "play", *map(str, options)])
        printed = capsys.readouterr()
        return status, printed.out, printed.err

    return run


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_bag_is_played_with_its_qos(run, network, tmp_path, storage):
    bag = write(tmp_path / "bag", storage=storage)
    assert run(bag) == (0, "Played 5 messages\n", "")
    assert network.written == [("rt/x", sample(number)) for number in range(5)]
    assert network.writers["rt/x"].reliability == ReliabilityPolicy.BEST_EFFORT


def test_while_it_plays_the_garbage_collector_passes_over_what_was_there(
    run, network, tmp_path, monkeypatch
):
    during = []

    def write_sample(self, cdr):
        during.append((gc.get_freeze_count() > 0, sys.getswitchinterval()))
        return True

    monkeypatch.setattr(Writer, "write", write_sample)
    gc.unfreeze()
    before = gc.get_freeze_count(), sys.getswitchinterval()
    assert run(write(tmp_path / "bag", times=[0]))[0] == 0
    assert during == [(True, pytest.approx(play._SWITCH_INTERVAL))]
    assert (gc.get_freeze_count(), sys.getswitchinterval()) == before


def test_topics_are_selected_and_renamed(run, network, tmp_path):
    bag = write(tmp_path / "bag", ["/a", "/b", "/c"], [0])
    assert run(bag, "--topics", "/a", "b", "-m", "a:=/else/a", "/b:=c", "-r", "9")[0] == 0
    assert [topic for topic, _ in network.written] == ["rt/else/a", "rt/c"]


@pytest.mark.parametrize(
    "options, played",
    [
        ([], [0, 10, 20, 30]),
        (["--start-offset", "0.015"], [20, 30]),
        (["--playback-duration", "0.01"], [0, 10]),
        (["--playback-duration", "-3"], [0, 10, 20, 30]),
        (["--start-offset", "0.01", "--playback-duration", "0.01"], [10, 20]),
        (["--playback-until-nsec", str(BEGIN + 20 * MS)], [0, 10, 20]),
        (["--playback-until-nsec", str(BEGIN), "--playback-duration", "0.02"], [0, 10, 20]),
        (["--playback-until-sec", str(BEGIN / S)], [0]),
    ],
)
def test_the_part_that_is_played(tmp_path, options, played):
    bag = write(tmp_path / "bag", times=[0, 10, 20, 30])
    parser = argparse.ArgumentParser()
    play.add_arguments(parser)
    readers = [BagReader(bag)]
    start, until = play.span(readers, parser.parse_args([str(bag), *options]))
    found = [(m.received_ns - BEGIN) // MS for m in play.merged(readers, ["/x"], start, until)]
    assert found == played


def test_bags_are_played_as_one(run, network, tmp_path):
    one = write(tmp_path / "one", ["/a"], [0, 20])
    two = write(tmp_path / "two", ["/b"], [10, 30], "sqlite3")
    assert run("-i", one, "-i", two, "-r", "5")[0] == 0
    assert [topic for topic, _ in network.written] == ["rt/a", "rt/b", "rt/a", "rt/b"]


@pytest.mark.parametrize(
    "options, expected", [(["--clock-topics-all"], 4), (["--clock-topics", "/b"], 2)]
)
def test_the_clock_before_each_message(run, network, tmp_path, options, expected):
    """A recorded clock is left out."""
    bag = write(tmp_path / "bag", ["/a", "/b", "/clock"], [0, 10])
    assert run(bag, "-r", "5", *options)[0] == 0
    clock = [from_cdr(CLOCK, cdr).clock for topic, cdr in network.written if topic == "rt/clock"]
    assert len(clock) == expected
    assert {(time.sec, time.nanosec) for time in clock} == {
        (BEGIN // S, 0), (BEGIN // S, 10 * MS),
    }  # fmt: skip


@pytest.mark.parametrize(
    "options, order",
    [([], [0, 1, 2]), (["--message-order", "received"], [0, 1, 2]),
     (["--message-order", "sent"], [2, 0, 1])],
)  # fmt: skip
def test_the_order_of_messages(run, network, tmp_path, options, order):
    """By the time of sending, which may be of a clock far from that of reception."""
    with BagWriter(tmp_path / "bag") as writer:
        topic = writer.add_topic(TopicMetadata("/x", STRING))
        for number, sent in enumerate((7, 8, 6)):
            writer.write(topic, sample(number), BEGIN + number * MS, sent * MS)
    assert run(tmp_path / "bag", *options)[0] == 0
    assert network.written == [("rt/x", sample(number)) for number in order]


def test_a_delay_before_each_pass(run, network, tmp_path, monkeypatch):
    """The event loop runs meanwhile; the second pass is interrupted in its delay."""
    log = []

    def spin(done, seconds=None):
        if seconds == 0.7:
            log.append(len(network.written))
        if len(log) == 2 or len(network.written) > 2:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(network, "spin", spin)
    assert run(write(tmp_path / "bag", times=[0, 1]), "-d", "0.7", "--loop")[0] == 0
    assert log == [0, 2]


@pytest.mark.parametrize("rate, period", [("2", 0.5), ("0", None), ("-1", 0.0)])
def test_how_often_the_state_is_printed(run, tmp_path, monkeypatch, rate, period):
    periods = []
    line = play.StatusLine
    monkeypatch.setattr(play, "StatusLine", lambda period: periods.append(period) or line(period))
    assert run(write(tmp_path / "bag"), "--progress-bar-update-rate", rate)[0] == 0
    assert periods == [period]


def test_options_without_effect(run, network, tmp_path):
    options = ["--disable-loan-message", "--log-level", "debug", "--progress-bar-separation-lines",
               "2"]  # fmt: skip
    assert run(write(tmp_path / "bag"), *options) == (0, "Played 5 messages\n", "")
    assert len(network.written) == 5


@pytest.mark.parametrize(
    "options, played",
    [
        (["--topics", "/a", "/c"], ["/a", "/c"]),
        (["--services", "/go"], ["/go/_service_event"]),
        (["--actions", "/fib"], ["/fib/_action/status"]),
        (["-e", "^/[bg]"], ["/b", "/go/_service_event"]),
        (["-x", "a|b|g"], ["/c"]),
        (["--exclude-topics", "/a", "--exclude-services", "/go", "--exclude-actions", "/fib"],
         ["/b", "/c"]),
    ],
)  # fmt: skip
def test_what_is_played(run, network, tmp_path, options, played):
    topics = ["/a", "/b", "/c", "/fib/_action/status", "/go/_service_event"]
    assert run(write(tmp_path / "bag", topics, [0]), *options)[0] == 0
    assert [topic.removeprefix("rt") for topic, _ in network.written] == played


@pytest.mark.parametrize("storage, status", [("mcap", 0), ("sqlite3", 1)])
def test_the_storage_may_be_given(run, tmp_path, storage, status):
    """In place of what the metadata say: a file of another one cannot be read."""
    found, _, err = run(write(tmp_path / "bag"), "-s", storage)
    assert found == status and ("bag_0.mcap" in err) == bool(status)


def test_the_queue_of_messages_that_were_read(run, network, tmp_path):
    bag = write(tmp_path / "bag", times=range(20))
    assert run(bag, "--read-ahead-queue-size", "1")[0] == 0
    assert len(network.written) == 20


@pytest.mark.parametrize("disabled", [False, True])
def test_keys_are_not_read_if_that_is_disabled(run, tmp_path, monkeypatch, disabled):
    enabled = []
    opened = keyboard.open_keyboard
    monkeypatch.setattr(keyboard, "open_keyboard", lambda on: enabled.append(on) or opened(on))
    options = ["--disable-keyboard-controls"] if disabled else []
    assert run(write(tmp_path / "bag"), *options)[0] == 0
    assert enabled == [not disabled]


def test_an_override_is_offered(run, network, tmp_path):
    bag = write(tmp_path / "bag", ["/a"], [0])
    file = tmp_path / "qos.yaml"
    file.write_text("/b: {depth: 3}\n")
    assert run(bag, "-m", "/a:=/b", "--qos-profile-overrides-path", file)[0] == 0
    assert network.writers["rt/b"] == QoSProfile(3)


def test_what_cannot_be_played_is_told(run, network, tmp_path):
    bag = write(tmp_path / "bag", ["/a", "/b//c", "/" + "x" * 300], [0])
    status, _, err = run(bag, "--topics", "/a", "/nowhere", "-e", "b|x")
    assert status == 0 and [topic for topic, _ in network.written] == ["rt/a"]
    nowhere, slashes, long = err.splitlines()
    assert nowhere == "WARNING: the bag has nothing of /nowhere"
    assert "/b//c is not played: it has two slashes in a row" in slashes
    assert "is not played: it has 301 characters" in long


@pytest.mark.parametrize(
    "options, status, said",
    [
        (["--topics", "/chater"], 1, "the bag has nothing of /chater; did you mean '/chatter'?"),
        (["-x", "."], 1, "no topic is selected"),
        (["-r", "0"], 2, "-r/--rate: '0' is not a number above 0"),
        (["-r", "nan"], 2, "-r/--rate"),
        (["-e", "["], 2, "'[' is not a regular expression"),
        (["-m", "/a"], 2, "expected OLD:=NEW"),
        (["-m", "/a:=b c"], 2, "'b c' is not a topic name"),
        (["--start-offset", "-1"], 2, "'-1' is not a number of 0 or more"),
        (["--playback-until-sec", "inf"], 2, "'inf' is not a number"),
        (["--clock", "-1"], 2, "--clock"),
        (["--clock", "5", "--clock-topics-all"], 2, "not allowed with"),
        (["--read-ahead-queue-size", "0"], 2, "not an integer above 0"),
    ],
)
def test_wrong_command_lines(run, network, tmp_path, options, status, said):
    bag = write(tmp_path / "bag", ["/chatter"], [0])
    found, out, err = run(bag, *options)
    assert (found, out) == (status, "")
    assert said in err and err.count("\n") == 1
    assert network.written == []


def test_an_offset_behind_the_end_is_told(run, network, tmp_path):
    bag = write(tmp_path / "bag", ["/x"], [0, 2500])
    status, out, err = run(bag, "--start-offset", "100")
    assert status == 0 and "Played 0 messages" in out
    assert "--start-offset 100: the bag ends at 2.5 s\n" in err


def test_without_a_bag(run, tmp_path):
    assert "give a bag" in run()[2]
    write(tmp_path / "trip", ["/x"], [0])
    status, _, err = run(tmp_path / "tripp")
    assert status == 2 and "tripp': no such folder or file; did you mean 'trip'?" in err
    status, _, err = run(tmp_path)
    assert status == 1 and "uros bag reindex" in err


@pytest.mark.parametrize("storage, suffix", [("mcap", "mcap"), ("sqlite3", "db3")])
def test_a_bag_that_is_cut_short_is_an_error_with_a_remedy(run, tmp_path, storage, suffix):
    bag = write(tmp_path / "bag", ["/x"], range(200), storage)
    (file,) = bag.glob(f"*.{suffix}")
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    status, _, err = run(bag, "-r", "100")
    assert status == 1 and "uros bag recover" in err and err.count("\n") == 1


@pytest.mark.parametrize("rule", ["", "/a", ":=/b", "/a:=", "/a:=1", "/a:=/b:=/c"])
def test_a_wrong_rule_is_named(rule):
    with pytest.raises(UsageError, match="--remap"):
        play.remappings([rule])
