"""Logging of a node to the console and to /rosout. Also runs on MicroPython."""

from support.services import Bench, raised

from uros.client import AGENT_AVAILABLE, AGENT_CONNECTED, rosout
from uros.client.logger_service import LoggerService
from uros.client.rosout import DEBUG, ERROR, FATAL, INFO, UNSET, WARN, LoggingSeverity
from uros.wire import ids


class Logs(Bench):
    """A node with a logger; ``lines`` are those of its console."""

    def __init__(self, name="arm", namespace="", **options):
        Bench.__init__(self, name, namespace, connect=False)
        self.node.executor.report = rosout.print_exception  # the default
        self.log = self.node.get_logger()
        self.lines = []
        self.node._rosout.console = self.lines.append
        if options.get("connect", True):
            self.connect()
            self.agent.samples.clear()

    def texts(self):
        """Return (severity, name, text) of each line on /rosout."""
        return [(message[2], message[3], message[4]) for message in self.heard("/rosout")]


def test_lines_are_written_to_the_console_and_to_rosout() -> None:
    bench = Logs("arm", "/left/hand")
    log = bench.log
    assert log.name == "left.hand.arm" and bench.node.get_logger() is log
    methods = (log.info, log.warning, log.warn, log.error, log.fatal)
    for method in methods:
        assert method("grün %d" % len(bench.lines))
    assert not log.debug("silent")
    heard = bench.heard("/rosout")
    assert [message[2:] for message in heard] == [
        [severity, "left.hand.arm", "grün %d" % i, "", "", 0]
        for i, severity in enumerate((INFO, WARN, WARN, ERROR, FATAL))
    ]
    assert all([message[0] >= 1700000000 and 0 <= message[1] < 1000000000 for message in heard])
    names = ("INFO", "WARN", "WARN", "ERROR", "FATAL")
    for i in range(5):
        line = bench.lines[i]
        assert line.startswith("[%s] [17" % names[i]), line
        assert line.endswith("] [left.hand.arm]: grün %d" % i), line
    assert Logs(connect=False).log.name == "arm"


def test_the_qos_of_rosout_is_that_of_ros() -> None:
    qos = Logs(connect=False).entity("/rosout").qos
    assert qos.reliable and qos.transient_local and qos.depth == 1000 and qos.lifespan_ms == 10000


def test_levels() -> None:
    log = Logs(connect=False).log
    assert log.get_effective_level() == INFO == LoggingSeverity.INFO
    for level in (DEBUG, INFO, WARN, ERROR, FATAL):
        log.set_level(level)
        for severity in (DEBUG, INFO, WARN, ERROR, FATAL):
            assert log.is_enabled_for(severity) == (severity >= level)
            assert log.log("x", severity) == (severity >= level)
    for wrong in (5, 60, -10):
        assert "is no level" in raised(ValueError, log.set_level, wrong)


def test_children_have_their_parents_level_until_they_have_their_own() -> None:
    bench = Logs()
    child = bench.log.get_child("elbow")
    below = child.get_child("left")
    assert below.name == "arm.elbow.left"
    bench.log.set_level(ERROR)
    assert below.get_effective_level() == ERROR and not below.info("x")
    child.set_level(DEBUG)
    assert below.debug("bent") and not bench.log.warn("x")
    below.set_level(FATAL)
    assert child.get_effective_level() == DEBUG and not below.error("x")
    below.set_level(UNSET)
    assert below.get_effective_level() == DEBUG
    assert bench.texts() == [(DEBUG, "arm.elbow.left", "bent")]
    raised(ValueError, bench.log.get_child, "")


def test_the_logger_services_get_and_set_levels() -> None:
    bench = Logs("arm", "/left")
    LoggerService(bench.node)
    bench.connect()
    child = bench.log.get_child("elbow")
    names = ["left.arm", "left.arm.elbow", "none"]
    asked = [["left.arm", 40], ["left.arm.elbow", 10], ["left.arm", 7], ["x", 60], ["y", 2**32 - 1]]
    ((first, second, third, fourth, fifth),) = bench.ask("/left/arm/set_logger_levels", [asked])
    assert first == second == [True, ""]
    for result in (third, fourth, fifth):
        assert not result[0] and "is no level" in result[1]
    assert not bench.log.warn("x") and child.debug("y")
    levels = bench.ask("/left/arm/get_logger_levels", [names])
    assert levels == [[["left.arm", 40], ["left.arm.elbow", 10], ["none", 0]]]
    many = [["n%d" % n, 10] for n in range(100)]
    (results,) = bench.ask("/left/arm/set_logger_levels", [many])
    assert len([1 for result in results if result[0]]) == 30 and "32 loggers" in results[99][1]
    bench.ask("/left/arm/set_logger_levels", [[["left.arm", 0]]])
    assert bench.log.get_effective_level() == INFO


def test_once_and_skip_first() -> None:
    log = Logs(connect=False).log
    assert [log.info("x", once=True) for _ in range(3)] == [True, False, False]
    assert [log.info("y", skip_first=True) for _ in range(3)] == [False, True, True]
    both = [log.info("z", skip_first=True, once=True) for _ in range(4)]
    assert both == [False, True, False, False]
    assert log.warn("x", once=True)  # another severity is another line
    assert log.get_child("c").info("x", once=True)
    # The same line with other numbers.
    assert [log.info("n = %d" % n, once=True) for n in range(3)] == [True, False, False]
    raised(TypeError, lambda: log.info("x", never=True))


def test_throttle() -> None:
    bench = Logs()
    logged = []
    for n in range(40):
        logged.append(bench.log.info("tick %d" % n, throttle_duration_sec=1.0))
        bench.run(100)
    assert [n for n in range(40) if logged[n]] == [0, 10, 20, 30]


def test_the_memory_of_logging_options_is_bounded() -> None:
    bench = Logs(connect=False)
    for n in range(1000):
        bench.log.info("%s" % "".join([chr(97 + int(digit)) for digit in str(n)]), once=True)
    assert len(bench.node._rosout._filters) <= 32


def test_lines_logged_before_the_session_are_sent_with_their_time() -> None:
    bench = Logs(connect=False)
    bench.agent.silent = True
    for n in range(12):
        bench.log.info("line %d" % n)
        bench.run(1000)
    assert len(bench.lines) == 12
    bench.agent.silent = False
    bench.connect()
    bench.run(200)
    heard = bench.heard("/rosout")
    assert [message[4] for message in heard] == ["line %d" % n for n in range(8)] + [
        "4 lines were left out"
    ]
    for n in range(8):
        age = heard[8][0] - heard[n][0] + (heard[8][1] - heard[n][1]) / 1e9
        assert abs(age - (12 - n)) < 1.5, (n, age)
    bench.log.info("now")
    assert bench.texts() == [(INFO, "arm", "now")]
    # The publisher is no handle of the executor any more: triggers do not wait for it.
    assert bench.entity("/rosout") not in bench.node.executor.handles


def test_queued_lines_cause_no_busy_waiting_before_the_session() -> None:
    bench = Logs(connect=False)
    bench.log.info("early")
    usual = bench.agent.submessage
    answering = [False]

    def submessage(kind, flags, payload):
        if kind != ids.TIMESTAMP or answering[0]:
            usual(kind, flags, payload)

    bench.agent.submessage = submessage
    bench.until(lambda: bench.node.state == AGENT_AVAILABLE)
    start = bench.clock.t
    for _ in range(40):
        bench.node.spin_once(0.01)
    assert bench.clock.t - start >= 300000 and bench.node.state == AGENT_AVAILABLE
    answering[0] = True
    bench.until(lambda: bench.node.state == AGENT_CONNECTED)
    bench.run(200)
    assert [text[2] for text in bench.texts()] == ["early"]


def test_lines_logged_without_an_agent_are_sent_later() -> None:
    bench = Logs()
    bench.log.info("one")
    assert len(bench.texts()) == 1
    bench.lose()
    bench.log.error("two")
    bench.connect()
    bench.run(200)
    assert bench.texts() == [(ERROR, "arm", "two")]


def test_a_refused_rosout_publisher_is_no_handle() -> None:
    bench = Logs(connect=False)
    bench.agent.refuse = {0x05: 0x82}  # the datawriter, for want of resources
    bench.node.connection.log = lambda text: None
    for _ in range(300):
        bench.node.spin_once(0.01)
        publisher = bench.entity("/rosout")
        assert publisher.created or publisher not in bench.node.executor.handles
    bench.agent.refuse = {}
    bench.log.info("one")
    bench.connect()
    assert bench.texts() == [(INFO, "arm", "one")]


def test_an_executor_without_room_sends_with_the_next_line() -> None:
    bench = Logs(connect=False)
    bench.node.executor.max_handles = 0
    bench.log.info("one")
    bench.connect()
    assert bench.texts() == []
    bench.log.info("two")
    assert [text[2] for text in bench.texts()] == ["one", "two"]


def test_a_burst_of_lines_is_limited() -> None:
    bench = Logs()
    for n in range(1000):
        bench.log.info("flood %d" % n)
    assert len(bench.lines) == 1000
    texts = bench.texts()
    assert 30 <= len(texts) <= 40
    left = 1000 - len(texts)
    bench.run(5000)
    bench.log.info("calm")
    assert [text[2] for text in bench.texts()] == ["%d lines were left out" % left, "calm"]
    for n in range(100):
        bench.log.info("steady %d" % n)
        bench.run(60)
    assert len([text for text in bench.texts() if "steady" in text[2]]) == 100
    assert bench.node._rosout.left_out == left


def test_long_lines_and_other_types_are_logged() -> None:
    bench = Logs()
    bench.log.info("x" * 5000)
    assert len(bench.lines[0]) > 5000
    ((_, _, text),) = bench.texts()
    assert len(text) == 1024
    bench.log.info(5)
    assert bench.texts()[0][2] == "5"


def test_exceptions_of_callbacks_are_logged() -> None:
    bench = Logs()

    def bad():
        raise RuntimeError("no oil")

    count = []
    bench.node.create_timer(0.1, bad)
    bench.node.create_timer(0.1, lambda: count.append(1))
    bench.run(320)
    texts = bench.texts()
    assert len(texts) == 3 == len(count)
    for severity, name, text in texts:
        assert severity == ERROR and name == "arm"
        assert "a callback raised" in text and "no oil" in text and "Traceback" in text
    assert bench.node.executor.failed == 3


def test_a_logger_keeps_the_programs_report() -> None:
    bench = Bench(connect=False)
    report = bench.node.executor.report
    bench.node.get_logger()
    assert bench.node.executor.report is report


def test_without_a_console() -> None:
    bench = Logs()
    bench.node._rosout.console = None
    assert bench.log.info("x") and bench.texts() == [(INFO, "arm", "x")]
