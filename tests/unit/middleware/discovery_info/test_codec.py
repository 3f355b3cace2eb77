"""``ros_discovery_info``, byte for byte.

The vectors are written by hand from the definitions of rmw_dds_common (ParticipantEntitiesInfo,
NodeEntitiesInfo, Gid) and from CDR; no ROS wrote them.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from uros.interfaces import load
from uros.interfaces.codec import from_cdr
from uros.middleware.discovery_info import codec
from uros.middleware.discovery_info.codec import decode

PARTICIPANT = bytes.fromhex("0110aabbccddeeff00112233000001c1")
READER = bytes.fromhex("0110aabbccddeeff0011223300000104")
WRITERS = [
    bytes.fromhex("0110aabbccddeeff0011223300000203"),
    bytes.fromhex("0110aabbccddeeff0011223300000303"),
]
NODES = [
    codec.NodeEntities("/garden", "weather", [], WRITERS),
    codec.NodeEntities("/", "a_node", [READER], []),
]

# 16 bytes a Gid: from Iron on.
HAND_16 = bytes.fromhex(
    "00010000"  # CDR, little endian
    "0110aabbccddeeff00112233000001c1"  # gid
    "02000000"  # two nodes
    "08000000" "2f67617264656e00"  # "/garden"
    "08000000" "7765617468657200"  # "weather"
    "00000000"  # no readers
    "02000000"  # two writers
    "0110aabbccddeeff0011223300000203"
    "0110aabbccddeeff0011223300000303"
    "02000000" "2f00" "0000"  # "/", padding
    "07000000" "615f6e6f646500" "00"  # "a_node", padding
    "01000000"  # one reader
    "0110aabbccddeeff0011223300000104"
    "00000000"  # no writers
)  # fmt: skip

# 24 bytes a Gid: up to Humble, the last eight zero.
HAND_24 = bytes.fromhex(
    "00010000"
    "0110aabbccddeeff00112233000001c1" "0000000000000000"
    "02000000"
    "08000000" "2f67617264656e00"
    "08000000" "7765617468657200"
    "00000000"
    "02000000"
    "0110aabbccddeeff0011223300000203" "0000000000000000"
    "0110aabbccddeeff0011223300000303" "0000000000000000"
    "02000000" "2f00" "0000"
    "07000000" "615f6e6f646500" "00"
    "01000000"
    "0110aabbccddeeff0011223300000104" "0000000000000000"
    "00000000"
)  # fmt: skip

HAND_EMPTY = bytes.fromhex("00010000" "0110aabbccddeeff00112233000001c1" "00000000")  # fmt: skip


@pytest.mark.parametrize(("size", "vector"), [(16, HAND_16), (24, HAND_24)])
def test_encode_gives_the_hand_written_bytes(size, vector):
    assert codec.encode(PARTICIPANT, NODES, size) == vector


def test_a_participant_without_nodes():
    assert codec.encode(PARTICIPANT, [], 16) == HAND_EMPTY


@pytest.mark.parametrize("vector", [HAND_16, HAND_24], ids=["16", "24"])
def test_both_sizes_are_decoded(vector):
    guid, nodes, _ = decode(vector)
    assert guid == PARTICIPANT
    assert [(n.namespace, n.name, n.readers, n.writers) for n in nodes] == [
        (n.namespace, n.name, n.readers, n.writers) for n in NODES
    ]


def test_encode_gives_the_message_of_the_interface_definitions():
    message = from_cdr(
        load("rmw_dds_common/msg/ParticipantEntitiesInfo"), codec.encode(PARTICIPANT, NODES, 16)
    )
    assert bytes(message.gid.data) == PARTICIPANT
    weather, second_node = message.node_entities_info_seq
    assert (weather.node_namespace, weather.node_name) == ("/garden", "weather")
    assert [bytes(gid.data) for gid in weather.writer_gid_seq] == WRITERS
    assert list(weather.reader_gid_seq) == []
    assert (second_node.node_namespace, second_node.node_name) == ("/", "a_node")
    assert [bytes(gid.data) for gid in second_node.reader_gid_seq] == [READER]


# rmw_dds_common: Gid.msg up to Humble, and from Iron on.
DEFINITIONS = {
    "ParticipantEntitiesInfo": "Gid gid\nNodeEntitiesInfo[] node_entities_info_seq\n",
    "NodeEntitiesInfo": "string<=256 node_namespace\nstring<=256 node_name\n"
    "Gid[] reader_gid_seq\nGid[] writer_gid_seq\n",
}
GIDS = {24: "char[24] data\n", 16: "char[16] data\n"}


@pytest.fixture(scope="module", params=sorted(GIDS))
def oracle(request):
    """A rosbags type store with the definitions of one size, and the size."""
    store = get_typestore(Stores.EMPTY)
    definitions = {}
    for name, text in (*DEFINITIONS.items(), ("Gid", GIDS[request.param])):
        definitions |= get_types_from_msg(text, f"rmw_dds_common/msg/{name}")
    store.register(definitions)
    return store, request.param


NAMES = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20)
GUIDS = st.lists(st.binary(min_size=16, max_size=16), max_size=4)
NODE_LISTS = st.lists(st.builds(codec.NodeEntities, NAMES, NAMES, GUIDS, GUIDS), max_size=5)


@given(st.binary(min_size=16, max_size=16), NODE_LISTS)
def test_rosbags_decodes_what_we_encode_and_the_reverse(oracle, guid, nodes):
    store, size = oracle
    types = store.types
    sample = codec.encode(guid, nodes, size)
    name = "rmw_dds_common/msg/ParticipantEntitiesInfo"
    read = store.deserialize_cdr(sample, name)
    pad = bytes(size - 16)

    def gid_bytes(gids):
        return [bytes(gid.data) for gid in gids]

    assert bytes(read.gid.data) == guid + pad
    assert [
        (
            item.node_namespace,
            item.node_name,
            gid_bytes(item.reader_gid_seq),
            gid_bytes(item.writer_gid_seq),
        )
        for item in read.node_entities_info_seq
    ] == [
        (
            node_info.namespace,
            node_info.name,
            [g + pad for g in node_info.readers],
            [g + pad for g in node_info.writers],
        )
        for node_info in nodes
    ]

    def gid(raw):
        return types["rmw_dds_common/msg/Gid"](np.frombuffer(raw + pad, np.uint8))

    message = types[name](
        gid(guid),
        [
            types["rmw_dds_common/msg/NodeEntitiesInfo"](
                node_info.namespace,
                node_info.name,
                [gid(g) for g in node_info.readers],
                [gid(g) for g in node_info.writers],
            )
            for node_info in nodes
        ],
    )
    back = decode(bytes(store.serialize_cdr(message, name)))
    assert back is not None and (back[0], back[2]) == (guid, size)
    assert [vars(item) for item in back[1]] == [vars(node) for node in nodes]


@given(st.binary(max_size=200), st.booleans(), st.sampled_from([16, 24]))
def test_any_bytes_decode_to_nothing_or_to_a_whole_message(rest, little, size):
    decoded = decode(bytes((0, little, 0, 0)) + rest)
    if decoded is not None:
        assert len(codec.encode(*decoded[:2], decoded[2])) - 4 <= len(rest)
    assert decode(codec.encode(PARTICIPANT, NODES, size) + rest + b"\1") is None


def test_the_topic_is_transient_local_with_a_depth_of_one():
    qos = codec.qos()
    assert qos.reliable and qos.transient_local and qos.depth == 1
    assert (codec.TOPIC, codec.TYPE) == (
        "ros_discovery_info",
        "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_",
    )
