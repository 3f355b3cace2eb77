"""Files of rules (``--control``): any bytes are rules, or refused by an error with the file's name.

Accepted rules can be applied to any names of a board.
"""

from collections.abc import Iterator
from random import Random

from uros import names
from uros.agent.policy.rules import GLOBAL, ConfigError, NameRefused, Rules
from uros.agent.policy.toml_file import MAX_FILE
from uros.middleware.base import MAX_DOMAIN, Service
from uros.qos import QoSProfile

from .records import MutateBytes
from .world import must
from .xml import scratch

_NODES = (("/", "n"), ("/a/b", "turtle_1"), ("/ü", ""))
_TOPICS = (
    "rt/odom", "rt/cmd_vel", "rt/tf", "rq/addRequest", "rr/tfReply", "ra/x", "rt/../x",
    "HelloWorldTopic", "rt/", "",
)  # fmt: skip
_ADDRESSES = ("192.168.1.9:4000", "[fe80::1%lo]:5", "/dev/ttyUSB0 (1)", "can0 (0x00000001)", "")


def one_input(data: bytes) -> None:
    path = scratch()
    path.write_bytes(data)
    rules = Rules()
    try:
        count = rules.load(path)
    except ConfigError as error:
        text = str(error)
        must(text.startswith(str(path)), f"the file is not named: {text[:200]}")
        must(len(text) < len(data) + 2000, "a text for people")
        return
    must(0 < count <= MAX_FILE, "a file without rules is taken")
    for key in (0, 0x4B0CBE99, 0xFFFFFFFF):
        for address in _ADDRESSES:
            for namespace, name in _NODES:
                _apply(rules.settings(key, address, f"{namespace.rstrip('/')}/{name}"), namespace)


def _apply(settings, namespace: str) -> None:  # type: ignore[no-untyped-def]
    must(settings.domain is None or 0 <= settings.domain <= MAX_DOMAIN, "a domain")
    try:
        must(not names.fault(names.join(*settings.node(namespace, "n")), 300), "a namespace")
    except NameRefused:
        must(namespace == "/ü" or len(settings.namespace) > 200, "a node is refused")
    for topic in _TOPICS:
        try:
            name = settings.topic(topic)
        except NameRefused:
            continue
        prefix, inside, _ = names.split_dds(name) or ("", "", "")
        must(prefix == topic[:2] or name == topic, f"the prefix of {name}")
        must(not prefix or not names.fault(inside), f"no name of ROS: {name}")
        must(
            not settings.namespace
            or inside.startswith(settings.namespace + "/")
            or inside in settings.remapped
            or (prefix == "rt" and inside in GLOBAL),
            f"{name} is outside of {settings.namespace}",
        )
    service = Service("rq/addRequest", "A_", "rr/addReply", "B_")
    try:
        renamed = settings.service(service)
        must(renamed.request_topic[2:-7] == renamed.reply_topic[2:-5], "one service")
    except NameRefused:
        must(len(settings.namespace) > 200 or bool(settings.remapped), "a service is refused")
    for topic in _TOPICS:
        qos = QoSProfile()
        settings.apply(qos, topic)
        must(1 <= qos.depth <= 1_000_000, f"a depth of {qos.depth}")
    if settings.limiter is not None:
        settings.limiter.write(memoryview(bytes(100)), lambda sample: True, lambda why: None)


_ALL = """
[[client]]
node = "/turtle_*"
namespace = "/hall"
domain = 5

[[client]]
key = ["0x4B0CBE99", 7]
address = "192.168.1.0/24"
remap = { "/cmd_vel" = "/turtle1/cmd_vel" }
max_rate = 100.5
max_size = 1_000
qos."/odom" = { reliability = "best_effort", depth = 1, deadline_ms = 100, durability = "volatile" }
qos."*" = { history = "keep_all", liveliness = "manual_by_topic", lifespan_ms = 5 }
"""


def seeds() -> Iterator[tuple[str, bytes]]:
    yield "all", _ALL.encode()
    for number, rule in enumerate(_ALL.split("[[client]]")[1:]):
        for line in rule.splitlines():
            if line:
                name = "".join(char if char.isalnum() else "_" for char in line[:12])
                yield f"{number}_{name}", f"[[client]]\ndomain = 1\n{line}\n".encode()


_WORDS = (
    b"[[client]]\n", b"[client]\n", b"inf", b"nan", b"-1", b"1e400", b"9" * 5000, b"0x", b'""',
    b"{}", b"[]", b"true", b"1979-05-27T07:32:00Z", b"'''", b'"""', b"\\u0000", b"\xff", b"[" * 200,
    b"domain = ", b"qos.", b"remap.", b"a." * 100, b"= ", b'"/a/b"', b"::/0", b"1.2.3.4/33", b"*[",
)  # fmt: skip


def mutate(data: bytes, random: Random, mutate_bytes: MutateBytes) -> bytes:
    draw = random.random()
    if draw < 0.4:
        return mutate_bytes(data)
    at = random.randrange(len(data) + 1)
    if draw < 0.6:
        return data[:at] + random.choice(_WORDS) + data[at:]
    lines = data.split(b"\n")
    at = random.randrange(len(lines))
    if draw < 0.7:
        del lines[at]
    elif draw < 0.85:
        lines.insert(at, random.choice(_ALL.encode().split(b"\n")))
    else:
        name, sign, value = lines[at].partition(b"=")
        value = random.choice(_WORDS) if random.random() < 0.5 else mutate_bytes(value)
        lines[at] = name + sign + value
    return b"\n".join(lines)
