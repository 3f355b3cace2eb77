import pytest

from uros.bag.metadata import TopicMetadata
from uros.bag.reader import BagReader
from uros.bag.writer import BagWriter
from uros.tools import cli

START = 1_700_000_000_000_000_000


def bag(name, topics, storage="mcap", count=30, offset=0):
    with BagWriter(name, storage, custom_data={name: "yes"}, ros_distro="jazzy") as writer:
        numbers = [writer.add_topic(TopicMetadata(*topic)) for topic in topics]
        for at in range(count):
            time = START + offset + at * 10
            writer.write(numbers[at % len(numbers)], at.to_bytes(8, "big"), time, time - 3)
    return [message for message in BagReader(name).messages()]


TOPICS = [
    ("/a", "std_msgs/msg/String"),
    ("/b", "std_msgs/msg/UInt8"),
    ("/c/_hidden", "std_msgs/msg/String"),
]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_simple_form(here, capsys):
    messages = bag("in", TOPICS)
    assert cli.main(["bag", "convert", "in", "out", "--compression", "zstd"]) == 0
    assert capsys.readouterr().out == "out: 30 messages in 1 file\n"
    reader = BagReader("out")
    assert list(reader.messages()) == messages
    assert reader.metadata.custom_data == {"in": "yes"} and reader.metadata.ros_distro == "jazzy"
    assert reader.topics == BagReader("in").topics


def test_mcap_to_sqlite_and_back_keeps_all_but_the_time_sent(here):
    messages = bag("in", TOPICS)
    assert cli.main(["bag", "convert", "in", "db", "-s", "sqlite3"]) == 0
    assert cli.main(["bag", "convert", "db", "out"]) == 0
    assert BagReader("db").metadata.storage == "sqlite3"
    found = list(BagReader("out").messages())
    assert found == [message._replace(sent_ns=message.received_ns) for message in messages]
    assert BagReader("out").topics == BagReader("in").topics


def test_a_merge_and_a_split(here, capsys):
    both = bag("one", TOPICS[:1]) + bag("two", TOPICS[1:], "sqlite3", offset=5)
    (here / "out.yaml").write_text(
        "output_bags:\n"
        "- {uri: all, all: true, include_hidden_topics: true, custom_data: {k: v}}\n"
        "- {uri: strings, storage_id: sqlite3, topic_types: [std_msgs/msg/String]}\n"
        "- {uri: some, regex: '^/[ab]', exclude_topics: [/a], max_bagfile_duration: 0}\n"
        f"- {{uri: part, all_topics: true, start_time_ns: {START}, end_time_ns: {START + 10},\n"
        "   compression_mode: file, compression_format: zstd}\n"
    )
    arguments = ["-i", "one", "-i", "two", "sqlite3", "-o", "out.yaml"]
    assert cli.main(["bag", "convert", *arguments]) == 0
    assert capsys.readouterr().out.splitlines()[0] == "all: 60 messages in 1 file"
    both.sort(key=lambda message: message.received_ns)
    reader = BagReader("all")
    assert list(reader.messages()) == both
    assert reader.metadata.custom_data == {"one": "yes", "two": "yes", "k": "v"}
    assert [topic.name for topic in BagReader("strings").topics] == ["/a"]
    assert [topic.name for topic in BagReader("some").topics] == ["/b"]
    assert [m.received_ns - START for m in BagReader("part").messages()] == [0, 5, 10]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "expected the key output_bags with a list of bags"),
        ("output_bags: {}", "expected the key output_bags"),
        ("output_bags: [x]", "output_bags[0]: expected keys with values"),
        ("output_bags: [{all: true}]", "output_bags[0]: uri is missing"),
        ("output_bags: [{uri: o, topcs: [/a]}]", "no key 'topcs'; did you mean 'topics'?"),
        ("output_bags: [{uri: o, topics: /a}]", "topics: expected a list, not '/a'"),
        ("output_bags: [{uri: o, all: 3}]", "all: expected true or false, not 3"),
        ("output_bags: [{uri: o, max_bagfile_size: -1}]", "expected a number from 0 on, not -1"),
        ("output_bags: [{uri: o, regex: '('}]", "regex: '(' is no regular expression"),
        ("output_bags: [{uri: o, storage_id: bag}]", "there is no storage 'bag'"),
        ("output_bags: [{uri: o, compression_mode: x}]", "expected none, file or message"),
        ("output_bags: [{uri: in, all: true}]", "in exists; choose another name"),
        ("output_bags: [{uri: o, storage_preset_profile: x}]", "expected none, fastwrite"),
        ("output_bags: [", "no YAML ("),
    ],
)
def test_wrong_options_are_named_and_nothing_is_written(here, capsys, text, said):
    bag("in", TOPICS)
    (here / "out.yaml").write_text(text)
    assert cli.main(["bag", "convert", "-i", "in", "-o", "out.yaml"]) == 1
    assert said in capsys.readouterr().err
    assert {path.name for path in here.iterdir()} == {"in", "out.yaml"}


@pytest.mark.parametrize(
    "arguments",
    [[], ["in"], ["-i", "in"], ["-o", "f"], ["-i", "in", "x", "-o", "f"], ["in", "out", "-o", "f"]],
)
def test_a_wrong_command_line(here, arguments):
    (here / "f").write_text("output_bags: [{uri: o}]")
    bag("in", TOPICS)
    assert cli.main(["bag", "convert", *arguments]) == 2


def test_a_damaged_input_leaves_no_output(here, capsys):
    bag("in", TOPICS)
    file = here / "in" / "in_0.mcap"
    data = bytearray(file.read_bytes())
    data[data.index(bytes(7) + b"\5")] ^= 1
    file.write_bytes(data)
    assert cli.main(["bag", "convert", "in", "out"]) == 1
    assert "uros bag recover in/in_0.mcap" in capsys.readouterr().err
    assert not (here / "out").exists()


def test_a_topic_of_two_types_is_named(here, capsys):
    bag("in", TOPICS)
    bag("other", [("/a", "std_msgs/msg/UInt8")])
    assert cli.main(["bag", "convert", "in", "other", "out"]) == 1
    assert "/a has the types" in capsys.readouterr().err
