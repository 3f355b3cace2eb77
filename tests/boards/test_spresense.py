"""The programs for the Spresense on their virtual boards, on both engines, through the agent to a
real rclpy node; the checks are those of the tutorial."""

import io
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import pytest
from conftest import ROOT
from PIL import Image
from support.agent import running_agent
from support.middleware import MIDDLEWARE, WITH_SERVICES
from support.peer import RosPeer
from support.variants import slow_except

from uros.boards.virtual.engine.runner import RunningBoard
from uros.interfaces import load as load_type
from uros.interfaces.codec import from_cdr, to_cdr

pytestmark = pytest.mark.timeout(120)

ENGINES = slow_except(["cpython", "micropython"], "micropython")
NODE = "my_node_serial"
INT32 = "std_msgs/msg/Int32"
IMAGE = "sensor_msgs/msg/CompressedImage"
TRIGGER = "std_srvs/srv/Trigger"
NUMBERS = "/my_publisher_serial"
PICTURES = "/image/compressed"
SECONDS = 20.0
# Printed when the line has been open for half a second.
LOOKING = "looking for the agent"
CONNECTED = "connected to the agent"


@pytest.fixture(params=ENGINES)
def engine(request):
    return request.param


@pytest.fixture(scope="module")
def peer(ros_python, domain):
    with RosPeer(ros_python, domain, ROOT / "tests" / "interop" / "service_peer.py") as running:
        for topic, kind in ((NUMBERS, INT32), (PICTURES, IMAGE)):
            running.do("subscribe", topic=topic, type=kind)
        yield running


def running_board(name, engine, program=None, **options):
    # Compiling to bytecode takes time: only the largest program is tested as bytecode.
    form = "mpy" if (name, engine) == ("spresense_camera", "micropython") else "py"
    return RunningBoard(program or name, name, engine, form=form, **options)


@contextmanager
def served(name, engine, domain):
    """A board that is connected to an agent of its own."""
    with running_board(name, engine) as board:
        with running_agent("serial", MIDDLEWARE, domain, device=board.path, baud=board.baud):
            board.wait(CONNECTED)
            yield board


def read(kind, cdr):
    return from_cdr(load_type(kind), cdr)


def number(peer):
    return read(INT32, peer.message(NUMBERS)).data


def forget(peer, topic):
    """Discard the messages of a topic so far."""
    peer.messages[topic].clear()
    peer.times[topic].clear()


def listed(peer, publishers):
    """Wait for the node in the ROS graph, and check that it has these publishers and no others."""
    node = peer.do("node", namespace="/", name=NODE, publishers=publishers)
    assert node["publishers"] == {topic: [kind] for topic, kind in publishers.items()}


def blinking(board):
    """Wait until LED0 has blinked, from now on."""
    before = len(board.shown("led0"))
    while len(board.shown("led0")) < before + 2:
        board.wait_shows("led0", "on", SECONDS)
        board.wait_shows("led0", "off", SECONDS)


# --- publisher ------------------------------------------------------------------------


def test_the_publisher_counts_ten_a_second_and_continues_with_a_new_agent(engine, peer, domain):
    forget(peer, NUMBERS)
    with running_board("spresense_publisher", engine) as board:
        board.wait(LOOKING)
        blinking(board)
        with running_agent("serial", MIDDLEWARE, domain, device=board.path):
            board.wait(CONNECTED)
            listed(peer, {NUMBERS: INT32})
            messages = [peer.timed_message(NUMBERS) for _ in range(11)]
            # A busy machine delays some messages: ten periods in a row must be in time.
            while not 0.85 < (messages[-1][1] - messages[-11][1]) / 1e9 < 1.15:
                assert len(messages) < 100, [now for _, now in messages]
                messages.append(peer.timed_message(NUMBERS))
            assert board.shows("led0") == "on"
        numbers = [read(INT32, cdr).data for cdr, _ in messages]
        first, last = numbers[0], numbers[-1]
        assert numbers == list(range(first, last + 1))
        if engine == "cpython":
            return  # the rest takes long, and is tested on one engine
        board.wait("no agent: ")
        blinking(board)
        forget(peer, NUMBERS)
        with running_agent("serial", MIDDLEWARE, domain, device=board.path):
            board.wait(CONNECTED)
            assert number(peer) > last


# --- publisher by Wi-Fi -----------------------------------------------------------------


def by_wifi(tmp_path, **changes):
    """Return a copy of the program with other values in config.py."""
    folder = tmp_path / "program"
    shutil.copytree(ROOT / "firmware" / "spresense_publisher_wifi", folder)
    config = folder / "config.py"
    for name, value in changes.items():
        text, count = re.subn(f"(?m)^{name} = .*$", f"{name} = {value!r}", config.read_text())
        assert count == 1
        config.write_text(text)
    return folder


@pytest.mark.parametrize(
    ("modem", "engine", "fault", "message"),
    [
        # tests/mpy/test_plugs.py has the other faults.
        ("gs2200", "micropython", "lost", "cannot join robots"),
        ("esp8266", "cpython", "closed", "has closed the link"),
    ],
)
def test_the_publisher_over_each_modem_and_its_faults(
    modem, engine, fault, message, peer, domain, tmp_path
):
    forget(peer, NUMBERS)
    program = by_wifi(tmp_path, MODEM=modem)
    with running_agent("udp", MIDDLEWARE, domain) as agent:
        # The agent's address in config.py is mapped to this one.
        with running_board(
            "spresense_publisher_wifi", engine, program, agent=("127.0.0.1", agent.transport.port)
        ) as board:
            board.wait(CONNECTED)
            board.wait_shows(modem, "in robots")
            listed(peer, {NUMBERS: INT32})
            first = number(peer)
            board.happen(f"{modem}:chatty")
            assert [number(peer) for _ in range(10)] == list(range(first + 1, first + 11))
            assert board.shows("led0") == "on"
            board.happen(f"{modem}:{fault}")
            board.wait(message)
            blinking(board)
            board.happen(f"{modem}:off")
            board.wait(CONNECTED)
            board.wait_shows("led0", "on")
            forget(peer, NUMBERS)
            assert number(peer) > first + 10


@pytest.mark.parametrize("modem", ["gs2200", "esp8266"])
def test_a_wrong_password_is_reported(modem, tmp_path):
    program = by_wifi(tmp_path, MODEM=modem, PASSWORD="wrong-one")
    with running_board("spresense_publisher_wifi", "cpython", program) as board:
        assert "password" in board.wait("cannot join robots")
        blinking(board)
        assert not board.ended


def test_a_configuration_error_is_reported_at_each_retry(tmp_path):
    program = by_wifi(tmp_path, MODEM="esp32")
    with running_board("spresense_publisher_wifi", "cpython", program) as board:
        for _ in range(2):  # the program retries
            board.wait("MODEM in config.py is 'esp32': make it gs2200 or esp8266")
            blinking(board)


# --- subscriber -------------------------------------------------------------------------


def send(peer, topic, value):
    cdr = [to_cdr(load_type(INT32)(data=value)).hex()]
    assert peer.do("publish", topic=topic, type=INT32, cdr=cdr)["subscribers"]


def test_the_subscriber_switches_led1(engine, peer, domain):
    topic = "/my_subscriber_serial"
    with served("spresense_subscriber", engine, domain) as board:
        infos = []
        while len(infos) != 1:  # that of the test before is still leaving
            infos = peer.do("topic", topic=topic, of="subscriptions")["infos"]
        assert infos[0]["type"] == INT32
        assert board.shows("led1") == "off"
        # Publish repeatedly, as `ros2 topic pub` without --once: the reader matches the writer a
        # moment later than the writer matches the reader.
        while board.shows("led1") == "off":
            send(peer, topic, 1)
            peer.do("node", namespace="/none", name="none", publishers={}, seconds=0.1)
        for value in (0, 5, 0, -1, 0, 2**31 - 1, 0, -(2**31)):
            send(peer, topic, value)
            board.wait_shows("led1", "on" if value else "off", SECONDS)
        assert board.shown("led1") == ["off", "on"] * 5
        assert board.shows("led0") == "on"


# --- camera -----------------------------------------------------------------------------


def picture(peer, after):
    """Check the next picture, whose stamp is later than ``after``; return the stamp in ns."""
    cdr, now = peer.timed_message(PICTURES)
    message = read(IMAGE, cdr)
    assert (message.header.frame_id, message.format) == ("myframe", "jpeg")
    stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    assert after < stamp < now
    assert len(message.data) <= 20_000
    with Image.open(io.BytesIO(bytes(message.data))) as image:
        image.load()  # decodes the whole picture
        assert (image.format, image.size) == ("JPEG", (320, 240))
    return stamp


def test_the_camera_publishes_a_picture_a_second_and_reports_faults(engine, peer, domain):
    forget(peer, PICTURES)
    stamp = time.time_ns()
    with served("spresense_camera", engine, domain) as board:
        listed(peer, {PICTURES: IMAGE})
        periods = []
        for _ in range(20):  # a busy machine delays some pictures
            stamp, before = picture(peer, stamp), stamp
            periods.append(stamp - before)
            if abs(periods[-1] - 10**9) < 3e8 and len(periods) > 1:
                break
        else:
            raise AssertionError(f"no picture comes a second after the one before: {periods}")
        faults = [("large", "led3"), ("failed", "led2"), ("torn", "led2")]
        for fault, led in faults[:1] if engine == "micropython" else faults[1:]:
            board.happen(f"camera:{fault}")
            board.wait_shows(led, "on", SECONDS)
            forget(peer, PICTURES)
            assert board.shows("led2" if led == "led3" else "led3") == "off"
            board.happen("camera:off")
            stamp = picture(peer, stamp)
            assert (board.shows("led2"), board.shows("led3")) == ("off", "off")
        assert board.shows("led0") == "on"
        assert set(board.shown("led1")) == {"off"}


# --- services ---------------------------------------------------------------------------


@contextmanager
def agent_process(domain, link):
    """An agent in a process of its own on this line."""
    process = subprocess.Popen(
        [sys.executable, "-m", "uros", "agent", "serial", "--dev", str(link), "-m",
         WITH_SERVICES, "--domain", str(domain), "--stop-at-eof"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env=dict(os.environ, PYTHONPATH=str(ROOT / "src")),
    )  # fmt: skip
    lines = []
    thread = threading.Thread(target=lambda: lines.extend(process.stdout), daemon=True)
    thread.start()
    try:
        yield
    finally:
        process.stdin.close()
        try:
            process.wait(SECONDS)
        finally:
            process.kill()
            thread.join()
            process.stdout.close()
    assert process.returncode == 0 and "internal error" not in "".join(lines), lines


@pytest.fixture(scope="class")
def link(domain, tmp_path_factory):
    """The path of a serial line that an agent waits for; each board of the class has it in turn."""
    path = tmp_path_factory.mktemp("line") / "ttyUSB0"
    with agent_process(domain, path):
        yield path


class TestServiceServer:
    def test_answers_alternate_and_led1_follows(self, engine, peer, link):
        name = "/srv_trigger_serial"
        with running_board("spresense_service_server", engine, link=link) as board:
            board.wait(CONNECTED)
            offered = {name: [TRIGGER]}
            graph = peer.do("services", namespace="/", name=NODE, services=offered, clients={})
            assert graph["found"] == [offered, {}]
            success, text = called(peer, name)
            board.wait(f"answered {success} {text}")
            first = int(text.removeprefix("Response[").rstrip("]"))  # it may have been called twice
            assert success == (first % 2 == 0)
            for n in range(first + 1, first + 5):
                assert called(peer, name) == (n % 2 == 0, f"Response[{n}]")
                board.wait_shows("led1", "off" if n % 2 else "on")
                assert board.wait("answered ") == f"answered {n % 2 == 0} Response[{n}]"
            assert board.shows("led0") == "on"


def called(peer, name):
    (cdr,) = peer.do("call", name=name, type=TRIGGER, cdr="0001000000")["replies"]
    response = from_cdr(load_type(TRIGGER).Response, bytes.fromhex(cdr))
    return response.success, response.message


class TestServiceClient:
    def test_the_service_is_called_every_two_seconds_and_led1_toggles(self, engine, peer, link):
        name = "/srv_trigger_py"
        # The board runs twice as fast as real time, so its two seconds are one.
        with running_board("spresense_service_client", engine, link=link, speed=2.0) as board:
            board.wait(CONNECTED)
            used = {name: [TRIGGER]}
            graph = peer.do("services", namespace="/", name=NODE, services={}, clients=used)
            assert graph["found"] == [{}, used]
            if engine == "cpython":
                board.wait("no answer: does a node serve /srv_trigger_py?")
            peer.do("serve", name=name, type=TRIGGER, text="Response[{}]", first=0)
            start, line = answer(board)
            first = int(line.split("[")[1].rstrip("]"))
            assert line == f"answer {first % 2 == 0} Response[{first}]"
            end, line = answer(board)
            assert line == f"answer {first % 2 == 1} Response[{first + 1}]"
            assert board.shown("led1") == ["off", "on", "off"]
            times = [start, end]
            while not 0.85 < times[-1] - times[-2] < 1.15:  # a busy machine delays some answers
                times.append(answer(board)[0])
                assert len(times) < 20, times
        peer.do("serve_no_more", name=name)


def answer(board):
    """Wait for the next answer; return its time in seconds, and its line of the console."""
    line = ""
    while not line.startswith("answer "):
        line = board.wait("answer ")
    return time.monotonic(), line
