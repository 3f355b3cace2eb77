"""Requests and results of the thread that imports rclpy; rcl and types are stand-ins."""

import os
import select
import subprocess
import threading

import pytest

from uros.middleware.base import MiddlewareError
from uros.middleware.ros2 import rcl, type_loader, types
from uros.middleware.ros_names import TypeName
from uros.middleware.wakeup_fd import WakeupFd

ADD, SUB, MUL = (TypeName("pkg", "srv", name) for name in ("Add", "Sub", "Mul"))
SECONDS = 10.0


class LoaderBench:
    def __init__(self):
        self.wakeup = WakeupFd()
        self.loader = type_loader.TypeLoader(self.wakeup)
        self.go, self.begun = threading.Event(), threading.Event()
        self.prepared, self.looked_up, self.missing = [], [], set()

    def prepare(self, *name):
        self.prepared.append(name)
        self.begun.set()
        assert self.go.wait(SECONDS)

    def find(self, name):
        self.looked_up.append(name)
        if name in self.missing:
            raise types.UnknownType("none such")

    def results(self):
        assert select.select([self.wakeup.fileno()], [], [], SECONDS)[0], "no results"
        self.wakeup.clear()
        return self.loader.take_results()


@pytest.fixture
def stand(monkeypatch):
    bench = LoaderBench()
    monkeypatch.setattr(rcl, "prepare", bench.prepare)
    monkeypatch.setattr(types, "find_service", bench.find)
    yield bench
    bench.go.set()
    bench.loader.close()
    bench.wakeup.close()


def test_each_type_is_loaded_once_in_order_and_rclpy_once(stand):
    for name in (ADD, SUB, ADD, SUB):
        stand.loader.request(name)
    assert stand.begun.wait(SECONDS)
    assert not stand.loader.has_results() and not stand.loader.is_loaded(ADD)
    stand.go.set()
    results = {}
    while len(results) < 2:
        results.update(stand.results())
    assert list(results.items()) == [(ADD, None), (SUB, None)]
    assert [stand.loader.is_loaded(name) for name in (ADD, SUB, MUL)] == [True, True, False]
    stand.loader.request(MUL)  # the thread has ended and starts again
    assert stand.results() == {MUL: None}
    assert stand.prepared == [tuple(ADD)] and stand.looked_up == [ADD, SUB, MUL]


def test_a_missing_type_is_no_failure_of_rclpy(stand):
    stand.missing.add(ADD)
    stand.go.set()
    stand.loader.request(ADD)
    results = stand.results()
    assert isinstance(results[ADD], types.UnknownType) and stand.loader.failure is None
    assert not stand.loader.is_loaded(ADD)
    stand.missing.clear()  # it has been installed meanwhile
    stand.loader.request(ADD)
    while not stand.loader.is_loaded(ADD):
        stand.results()


def test_a_cancelled_request_is_not_loaded(stand):
    stand.loader.request(ADD)
    assert stand.begun.wait(SECONDS)
    stand.loader.request(SUB)
    stand.loader.cancel(SUB)
    stand.loader.cancel(MUL)
    stand.go.set()
    stand.results()
    stand.loader._thread.join(SECONDS)
    assert stand.looked_up == [ADD]


def test_nothing_is_loaded_after_closing(stand):
    stand.loader.close()
    stand.loader.request(ADD)
    assert stand.loader._thread is None
    stand.loader.close()


# --- the process that goes ahead ------------------------------------------------------


def test_an_import_that_crashes_ends_another_process():
    rcl._elsewhere("raise ImportError")  # the import raises it in this process
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
