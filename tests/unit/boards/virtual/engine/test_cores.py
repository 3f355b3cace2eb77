"""A board's second core: the mailboxes between the cores, and a program on each core."""

import errno
import textwrap

import pytest

from uros.boards.virtual.engine.cores import MOST_NUMBERS, Mail
from uros.boards.virtual.engine.runner import RunningBoard

ENGINES = ("cpython", "micropython")
BOARD = "ra6m5_sensor_node"


def test_a_mailbox_keeps_the_newest_message_of_each_number_in_order():
    mail = Mail()
    for number, data in ((3, b"a"), (1, b"b"), (3, b"c")):
        mail.send(0, number, data)
    mail.send(1, 2, b"other way")
    assert [mail.receive(0) for _ in range(3)] == [b"\1b", b"\3c", b""]
    assert mail.receive(1) == b"\2other way"
    mail.send(0, 1, b"")
    assert mail.receive(0) == b"\1"
    mail.send(0, 1, b"")
    mail.clear()
    assert mail.receive(0) == b""


def test_unknown_mailboxes_are_refused_and_numbers_are_bounded():
    mail = Mail()
    for box, number in ((2, 1), (0, 0)):
        with pytest.raises(OSError) as caught:
            mail.send(box, number, b"")
        assert caught.value.errno == errno.EINVAL
    with pytest.raises(OSError):
        mail.receive(2)
    for number in range(1, MOST_NUMBERS + 1):
        mail.send(0, number, b"")
    mail.send(0, 1, b"again")
    with pytest.raises(OSError) as caught:
        mail.send(0, MOST_NUMBERS + 1, b"")
    assert caught.value.errno == errno.ENOMEM


@pytest.fixture
def program(tmp_path):
    """Return a function that makes a folder of modules."""

    def make(**modules):
        folder = tmp_path / "program"
        folder.mkdir()
        for name, text in modules.items():
            (folder / f"{name}.py").write_text(textwrap.dedent(text))
        return folder

    return make


MAIN = """
    import time, second_core
    to, back = second_core.Mailbox(0), second_core.Mailbox(1)
    second_core.start("other")
    try:
        second_core.start("other")
    except OSError as error:
        print("once", error.args[0])
    def ask(value):
        to.send(7, value)
        while not back.receive():
            time.sleep_ms(1)
        return back.value
    for value in (None, True, -5, 0.5, "a'b", (1, [2.5, "c"]), float("inf")):
        print("answer", ask(value) == [value])
    nan = ask(float("nan"))[0]
    print("nan", nan != nan)
    print("hangs")
    while True:
        pass
"""
SECOND_CORE = """
    import time
    count = 0
    def start(inbox, outbox):
        global boxes
        boxes = inbox, outbox
        print("started")
    def step():
        global count
        time.sleep_ms(10)
        count += 1
        if count % 20 == 0:
            print("alive")
        number = boxes[0].receive()
        if number:
            boxes[1].send(number, [boxes[0].value])
"""


@pytest.mark.parametrize(
    "engine, form",
    [
        ("cpython", "py"),
        pytest.param("micropython", "py", marks=pytest.mark.slow),
        ("micropython", "mpy"),
    ],
)
def test_two_cores_exchange_messages_and_one_runs_while_the_other_hangs(program, engine, form):
    with RunningBoard(program(main=MAIN, other=SECOND_CORE), BOARD, engine, form=form) as board:
        board.wait(f"once {errno.EBUSY if engine == 'cpython' else 5}")
        for _ in range(7):
            board.wait("answer True")
        board.wait("nan True")
        board.wait("hangs")
        board.wait("alive")
        board.wait("alive")
        # A reset restarts both cores.
        board.reset()
        board.wait("started")
        board.wait("nan True")


@pytest.mark.parametrize("engine", ENGINES)
def test_an_error_of_the_second_core_is_reported_and_the_first_core_runs_on(program, engine):
    main = """
        import time, second_core
        second_core.start("other")
        while True:
            time.sleep_ms(100)
            print("first")
    """
    core = """
        def start(inbox, outbox):
            pass
        def step():
            raise RuntimeError("of the second core")
    """
    with RunningBoard(program(main=main, other=core), BOARD, engine) as board:
        board.wait("RuntimeError: of the second core")
        board.wait("first")
        assert not board.ended


@pytest.mark.parametrize("engine", ENGINES)
def test_a_missing_module_is_reported(program, engine):
    main = "import second_core\nsecond_core.start('other')\nimport time\ntime.sleep(60)\n"
    with RunningBoard(program(main=main), BOARD, engine) as board:
        board.wait("ImportError: no module named 'other'")
