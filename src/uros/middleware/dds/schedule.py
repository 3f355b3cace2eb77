"""What a middleware does by time: one list of jobs, each with its own deadline."""

from __future__ import annotations

from typing import Protocol


class Scheduled(Protocol):
    """A job.

    Attributes:
        due: When :meth:`tick` is to be called (``time.monotonic``); None: nothing is due.
    """

    due: float | None

    def tick(self, now: float) -> None:
        """Do what is due, and set :attr:`due` to the next time."""


class Schedule:
    """The jobs of one middleware, run in the order in which they were added."""

    def __init__(self) -> None:
        self._jobs: list[Scheduled] = []

    def __contains__(self, job: Scheduled) -> bool:
        return job in self._jobs

    def add(self, job: Scheduled) -> None:
        """Run a job whenever it is due."""
        self._jobs.append(job)

    def remove(self, job: Scheduled) -> None:
        """Run a job no more; idempotent."""
        if job in self._jobs:
            self._jobs.remove(job)

    def next_deadline(self) -> float | None:
        """Return when the next job is due (``time.monotonic``), or None."""
        soonest: float | None = None
        for job in self._jobs:
            due = job.due
            if due is not None and (soonest is None or due < soonest):
                soonest = due
        return soonest

    def tick(self, now: float) -> None:
        """Run the jobs that are due."""
        for job in self._jobs.copy():
            due = job.due
            if due is not None and due <= now:
                job.tick(now)
