"""What the thread that imports rclpy is asked and tells; rcl and types are stand-ins."""

import os
import select
import subprocess
import threading

import pytest

from uros.middleware.base import MiddlewareError
from uros.middleware.ros2 import rcl, type_loader, types
from uros.middleware.ros2.names import TypeName
from uros.middleware.wakeup_fd import Wake

ADD, SUB, MUL = (TypeName("pkg", "srv", name) for name in ("Add", "Sub", "Mul"))
SECONDS = 10.0


class Stand:
    def __init__(self):
        self.wake = Wake()
        self.one = type_loader.Preparation(self.wake)
        self.go, self.begun = threading.Event(), threading.Event()
        self.prepared, self.found, self.missing = [], [], set()

    def prepare(self, *name):
        self.prepared.append(name)
        self.begun.set()
        assert self.go.wait(SECONDS)

    def find(self, name):
        self.found.append(name)
        if name in self.missing:
            raise types.UnknownType("none such")

    def news(self):
        assert select.select([self.wake.fileno()], [], [], SECONDS)[0], "no news"
        self.wake.clear()
        return self.one.news()


@pytest.fixture
def stand(monkeypatch):
    one = Stand()
    monkeypatch.setattr(rcl, "prepare", one.prepare)
    monkeypatch.setattr(types, "find_service", one.find)
    yield one
    one.go.set()
    one.one.close()
    one.wake.close()


def test_each_type_once_in_the_order_of_asking_and_rclpy_once(stand):
    for name in (ADD, SUB, ADD, SUB):
        stand.one.want(name)
    assert stand.begun.wait(SECONDS)
    assert not stand.one.has_news() and not stand.one.has(ADD)
    stand.go.set()
    told = {}
    while len(told) < 2:
        told.update(stand.news())
    assert list(told.items()) == [(ADD, None), (SUB, None)]
    assert stand.one.has(ADD) and stand.one.has(SUB) and not stand.one.has(MUL)
    stand.one.want(MUL)  # the thread has ended; it begins again
    assert stand.news() == {MUL: None}
    assert stand.prepared == [tuple(ADD)] and stand.found == [ADD, SUB, MUL]


def test_a_type_that_is_not_there_is_no_failure_of_rclpy(stand):
    stand.missing.add(ADD)
    stand.go.set()
    stand.one.want(ADD)
    told = stand.news()
    assert isinstance(told[ADD], types.UnknownType) and stand.one.failure is None
    assert not stand.one.has(ADD)
    stand.missing.clear()  # it has been installed meanwhile
    stand.one.want(ADD)
    while not stand.one.has(ADD):
        stand.news()


def test_what_is_forgotten_is_not_looked_for(stand):
    stand.one.want(ADD)
    assert stand.begun.wait(SECONDS)
    stand.one.want(SUB)
    stand.one.forget(SUB)
    stand.one.forget(MUL)
    stand.go.set()
    stand.news()
    stand.one._thread.join(SECONDS)
    assert stand.found == [ADD]


def test_nothing_begins_after_the_end(stand):
    stand.one.close()
    stand.one.want(ADD)
    assert stand.one._thread is None
    stand.one.close()


# --- the process that goes ahead ------------------------------------------------------


def test_an_import_that_crashes_does_so_elsewhere():
    rcl._elsewhere("raise ImportError")  # will be raised here
    with pytest.raises(MiddlewareError, match=r"ends by signal 6\): install that RMW"):
        rcl._elsewhere("import os; os.abort()")


def test_an_rmw_that_rcl_does_not_find_is_named(monkeypatch):
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_nowhere_cpp")
    with pytest.raises(MiddlewareError, match="RMW_IMPLEMENTATION=rmw_nowhere_cpp"):
        rcl._elsewhere("import os; os._exit(102)")


@pytest.mark.parametrize("failure", [OSError("no more processes"), "timeout"])
def test_without_that_process_the_import_goes_on(monkeypatch, failure):
    def run(*arguments, **options):
        raise subprocess.TimeoutExpired("python", 1) if failure == "timeout" else failure

    monkeypatch.setattr(subprocess, "run", run)
    rcl._elsewhere("import os")


def test_a_library_that_cannot_be_mapped_is_left_to_the_import(monkeypatch, tmp_path):
    (tmp_path / "_rclpy_pybind11.so").write_bytes(b"no library")

    class Spec:
        submodule_search_locations = (str(tmp_path), os.devnull)

    monkeypatch.setattr(rcl, "find_spec", lambda name: Spec)
    rcl._map()
    monkeypatch.setattr(rcl, "find_spec", lambda name: None)
    rcl._map()
