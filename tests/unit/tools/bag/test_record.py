import signal

import pytest
from support.bag_network import Network
from support.signals import default_signals

from uros.bag.errors import BagError
from uros.bag.reader import BagReader
from uros.bag.writer import BagWriter
from uros.interfaces import load
from uros.interfaces.codec import to_cdr
from uros.qos import QoSProfile
from uros.tools import cli
from uros.tools.bag import keyboard, message_cache, record

S = 10**9


def ctrl_c():
    signal.raise_signal(signal.SIGINT)


@pytest.fixture
def run(monkeypatch, tmp_path, capsys):
    """Records on a network until its script is over; returns status, output and errors."""

    def run(network, *options, bag="bag"):
        network.script.append(ctrl_c)
        monkeypatch.setattr(record, "join", lambda args, node_name: network)
        status = cli.main(["bag", "record", "-o", str(tmp_path / bag), *options])
        printed = capsys.readouterr()
        return status, printed.out, printed.err

    return run


def sending(*steps):
    """Return a network on which /x has a message at each of these seconds, one at each turn."""
    network = Network()
    network.publish("/x", QoSProfile())
    network.script = [
        step if callable(step) else lambda step=step: network.send("/x", at=step * S, sent=step * S)
        for step in steps
    ]
    return network


def times(bag):
    return [message.received_ns // S for message in BagReader(bag).messages()]


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_recording_with_whole_files(run, tmp_path, stop):
    network = sending(1, 2, lambda: signal.raise_signal(stop))
    with default_signals():
        status, out, err = run(network, "-a")
    assert status == 0 and err == ""
    assert out == (
        f"Recording into {tmp_path / 'bag'}\nSubscribed to topic '/x'\n"
        f"Recorded 2 messages (8 B) into {tmp_path / 'bag'}, 0 dropped\n"
    )
    assert times(tmp_path / "bag") == [1, 2]
    assert network.log[-1] == ("/x", None)


def test_options_of_the_bag(run, tmp_path):
    steps = (1, 2, 3, 9)
    run(sending(*steps), "-a", "-s", "sqlite3", "--custom-data", "robot=r2", "robot=r3", "x=",
        bag="lite")  # fmt: skip
    reader = BagReader(tmp_path / "lite")
    assert reader.metadata.storage == "sqlite3"
    assert reader.metadata.custom_data == {"robot": "r3", "x": ""}
    assert times(tmp_path / "lite") == [*steps]
    mode = ("--compression-mode", "message", "--compression-format")
    for name, options in {
        "split": ["-s", "mcap", "-d", "5"],
        "zstd": ["-s", "mcap", *mode, "zstd"],
        "lz4": ["-s", "mcap", *mode, "lz4", "-b", "100000"],
    }.items():
        assert run(sending(*steps), "/x", *options, bag=name)[0] == 0
        reader = BagReader(tmp_path / name)
        assert times(tmp_path / name) == [*steps]
        assert len(reader.files) == (2 if name == "split" else 1)


def test_without_discovery_topics_of_the_beginning_are_recorded(run, tmp_path):
    network = sending(1)
    network.script.append(lambda: network.publish("/late", QoSProfile()))
    network.script += [lambda: None] * 3
    assert run(network, "-a", "--no-discovery", "-p", "1")[0] == 0
    assert [topic.name for topic in BagReader(tmp_path / "bag").topics] == ["/x"]


def test_new_topics_are_discovered(run, tmp_path):
    network = sending(1)
    network.script.append(lambda: network.publish("/late", QoSProfile()))

    def until_recorded():
        if "/late" not in network.listening:
            network.script.insert(0, until_recorded)

    network.script.append(until_recorded)
    assert run(network, "-a", "-p", "1")[0] == 0
    assert [topic.name for topic in BagReader(tmp_path / "bag").topics] == ["/x", "/late"]


@pytest.mark.skipif(not hasattr(signal, "SIGUSR1"), reason="not on this platform: no SIGUSR1")
def test_a_snapshot_is_written_at_a_signal(run, tmp_path):
    steps = (1, 2, lambda: signal.raise_signal(signal.SIGUSR1), lambda: None, 3)
    status, out, _ = run(sending(*steps), "-a", "--snapshot-mode")
    assert status == 0 and "Snapshot of 2 messages\n" in out
    assert times(tmp_path / "bag") == [1, 2]
    assert run(sending(*steps), "-a", bag="whole")[0] == 0
    assert times(tmp_path / "whole") == [1, 2, 3]


@pytest.mark.parametrize(
    "options, recorded",
    [
        (["-a"], ["/a/b", "/fib/_action/status", "/go/_service_event", "/leaf"]),
        (["--all-topics"], ["/a/b", "/leaf"]),
        (["--all-services"], ["/go/_service_event"]),
        (["--all-actions"], ["/fib/_action/status"]),
        (["--topics", "/leaf"], ["/leaf"]),
        (["--services", "/go", "--actions", "/fib"],
         ["/fib/_action/status", "/go/_service_event"]),
        (["--topic-types", "std_msgs/Int32"], ["/leaf"]),
        (["-a", "--exclude-topic-types", "std_msgs/msg/Int32", "-x", "fib"],
         ["/a/b", "/go/_service_event"]),
        (["-a", "--exclude-topics", "/leaf", "--exclude-services", "/go",
          "--exclude-actions", "/fib"], ["/a/b"]),
        (["-e", "[bl]", "--include-hidden-topics"], ["/_hidden/b", "/a/b", "/fib/_action/status",
                                                      "/leaf"]),
        (["--all-topics", "--ignore-leaf-topics"], ["/a/b"]),
        (["--all-topics", "--include-unpublished-topics"], ["/a/b", "/leaf", "/nobody"]),
    ],
)  # fmt: skip
def test_what_is_recorded(run, tmp_path, options, recorded):
    network = Network()
    for topic in ("/_hidden/b", "/a/b", "/fib/_action/status", "/go/_service_event"):
        network.publish(topic, QoSProfile())
        network.readers[topic] = [None]
    network.publish("/leaf", QoSProfile(), types=["std_msgs/msg/Int32"])
    network.publish("/nobody")
    assert run(network, *options)[0] == 0
    assert sorted(topic.name for topic in BagReader(tmp_path / "bag").topics) == recorded


def test_options_of_the_recorder(monkeypatch, tmp_path, capsys):
    """Its node, its clock, its queue, its keys, and the profiles of its subscriptions."""
    network, names, caches, enabled = sending(), [], [], []
    file = tmp_path / "qos.yaml"
    file.write_text("/x: {depth: 3}\n")
    cache, opened = message_cache.MessageCache, keyboard.open_keyboard
    monkeypatch.setattr(record, "join", lambda args, node_name: names.append(node_name) or network)
    monkeypatch.setattr(
        message_cache, "MessageCache", lambda *args: caches.append(args) or cache(*args)
    )
    monkeypatch.setattr(keyboard, "open_keyboard", lambda on: enabled.append(on) or opened(on))
    clock = to_cdr(load("rosgraph_msgs/msg/Clock")(clock=load("builtin_interfaces/Time")(sec=5)))

    def send_when_subscribed():
        if "/x" in network.listening:
            network.send("/x", at=9 * S)
        else:
            network.script.insert(0, send_when_subscribed)

    network.script = [lambda: network.send("/clock", clock), send_when_subscribed, ctrl_c]
    line = f"""bag record -a -o {tmp_path / "bag"} --node-name ears --use-sim-time -p 1
        --max-cache-size 5000 --qos-profile-overrides-path {file} --disable-keyboard-controls"""
    assert cli.main(line.split()) == 0
    assert names == ["ears"] and caches == [(5000, False)] and enabled == [False]
    assert ("/x", QoSProfile(3)) in network.log
    assert times(tmp_path / "bag") == [5]


def test_options_without_effect(run, tmp_path):
    options = ["-f", "cdr", "--log-level", "debug", "--compression-queue-size", "1",
               "--compression-threads", "2", "--compression-threads-priority", "-1"]  # fmt: skip
    assert run(sending(1), "-a", *options)[0] == 0
    assert times(tmp_path / "bag") == [1]


def test_start_paused(run, tmp_path):
    assert run(sending(1, 2), "-a", "--start-paused")[0] == 0
    assert times(tmp_path / "bag") == []


def test_a_topic_that_is_not_there_is_told(run, monkeypatch):
    monkeypatch.setattr(record, "_MISSING_SECONDS", 0.0)
    network = sending(lambda: None)
    network.publish("/chatter", QoSProfile())
    status, _, err = run(network, "/chater", "/x")
    assert status == 0
    assert "appears; it is not there yet in domain 0; did you mean '/chatter'?\n" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("fails", ["write", "flush", "add_topic", "close"])
def test_a_full_disk_ends_the_recording_and_says_what_is_lost(run, monkeypatch, tmp_path, fails):
    real = BagWriter.close

    def fail(self, *arguments):
        real(self)
        raise BagError("bag_0.mcap: No space left on device")

    monkeypatch.setattr(BagWriter, fails, fail)
    network = sending(1, 2)
    network.script += [lambda: None] * 20
    status, out, err = run(network, "-a")
    assert status == 1
    assert "No space left on device; 'uros bag recover" in err and err.count("\n") == 1
    assert "Recorded " in out
    if fails != "close":
        assert "2 messages are lost" in err and "Recorded 0 messages" in out


@pytest.mark.parametrize(
    "options, status, said",
    [
        ([], 2, "nothing to record: give topics, or one of --all"),
        (["-x", "x"], 2, "nothing to record"),
        (["-e", "("], 2, "'(' is not a regular expression"),
        (["a b"], 2, "'a b' is not a topic name"),
        (["-a", "-s", "rosbag"], 2, "-s/--storage: invalid choice"),
        (["-a", "-b", "-1"], 2, "-b/--max-bag-size"),
        (["-a", "-b", "10", "-s", "mcap"], 1, "files of 10 bytes are too small"),
        (["-a", "-p", "0"], 2, "-p/--polling-interval: '0' is not an integer above 0"),
        (["-a", "--use-sim-time", "--no-discovery"], 2, "needs discovery"),
        (["-a", "--compression-format", "zstd"], 2, "needs --compression-mode"),
        (["-a", "--compression-mode", "file", "-s", "sqlite3"], 1, "not compressed"),
        (["-a", "--snapshot-mode", "--max-cache-size", "0"], 2, "--max-cache-size"),
        (["-a", "--node-name", "a/b"], 2, "a name has no slash"),
        (["-a", "--node-name", "1"], 2, "begins with a digit"),
        (["-a", "--custom-data", "x"], 2, "expected KEY=VALUE"),
        (["-a", "--qos-profile-overrides-path", "none.yaml"], 1, "none.yaml: No such file"),
    ],
)
def test_wrong_command_lines(run, tmp_path, options, status, said):
    found, out, err = run(sending(), *options)
    assert (found, out) == (status, "")
    assert said in err and err.count("\n") == 1
    assert not (tmp_path / "bag").exists()


def test_a_folder_that_exists_is_left_alone(run, tmp_path):
    (tmp_path / "bag").mkdir()
    status, _, err = run(sending(1), "-a")
    assert status == 1 and "bag exists already; give another one: --output" in err
    assert list((tmp_path / "bag").iterdir()) == []


def test_the_default_folder_has_the_time(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    network = sending(ctrl_c)
    monkeypatch.setattr(record, "join", lambda args, node_name: network)
    assert cli.main(["bag", "record", "-a"]) == 0
    (folder,) = tmp_path.glob("rosbag2_????_??_??-??_??_??")
    assert times(folder) == []
