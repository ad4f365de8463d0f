"""Many jobs on a Ray cluster; whatever node dies, each job is worked off and counted once."""

from __future__ import annotations

import contextlib
import itertools
import math
import os
import socket
from collections.abc import Generator, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import ray
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from robosim.errors import InputError, shown
from robosim.experiments.jobs import Failure, Job, Work, attempt_job
from robosim.experiments.local import ONE_THREAD
from robosim.experiments.results import Result
from robosim.experiments.runner import Watch
from robosim.plugins import variable_elsewhere

_LOOK = 0.5
"""Time between two looks at what the jobs report, s."""
_TRIES = 5
"""How often a job is begun again whose node or process has died."""
_PATIENCE = 60.0
"""How long a job waits for the process of a dead node to let go of the folder, s."""
_LISTENING = 10.0
"""How long a cluster may take to answer at its address, s."""
_SAVING = 120.0
"""How long an interrupted job may take to save, s."""


class RayEngine:
    """Works off jobs as tasks of a Ray cluster, on a core each; robosim must be installed on every node.

    A job that a dead node or process had begun is begun again on another: where the folder of jobs is on a
    disk that nodes share, it goes on there, and else from its beginning. Only the process that runs this
    writes records.
    """

    def __init__(self, address: str | None = None, workers: int | None = None) -> None:
        """Use the cluster at `address`, or start Ray here; at most `workers` jobs at a time, if given."""
        self._address = address
        self._workers = workers

    def run(
        self, jobs: Iterable[Job], work: Work, root: Path, watch: Watch
    ) -> Generator[Result | Failure, None, None]:
        """Yield what comes of each job; those at work are asked to end by KeyboardInterrupt."""
        waiting = iter(jobs)
        first = next(waiting, None)
        if first is None:
            return
        waiting = itertools.chain([first], waiting)
        with _connected(self._address, self._workers):
            board = _make_board()
            # A process for each job, as of the local engine: nothing of one is left to the next.
            attempt = ray.remote(num_cpus=1, max_retries=_TRIES, max_calls=1)(_attempt)
            running = dict[Any, Job]()
            # Without a limit all are handed over at once, so that a cluster can grow with them.
            limit = self._workers or math.inf
            try:
                while True:
                    while len(running) < limit and (job := next(waiting, None)):
                        running[attempt.remote(job, work, root, board)] = job
                    if not running:
                        return
                    ended, _ = ray.wait(list(running), timeout=_LOOK)
                    _pass_on(board, {job.key: job for job in running.values()}, watch)
                    for task in ended:
                        job = running.pop(task)
                        yield _outcome(task, job)
            finally:
                _end(list(running))


def _attempt(job: Job, work: Work, root: Path, board: Any) -> Result | Failure:
    """Do a job in a process of its own, and go on where a dead one has left it."""
    # Whether anybody hears it makes no difference: the board may have gone with its node.
    board.note.remote(job.key, 0.0)
    return attempt_job(job, work, root, lambda done: board.note.remote(job.key, done), _PATIENCE)


class _Board:
    """Where jobs note which share of them is done."""

    def __init__(self) -> None:
        self._news: dict[str, float] = {}

    def note(self, key: str, done: float) -> None:
        """Take down the share of a job."""
        self._news[key] = done

    def news(self) -> dict[str, float]:
        """Return what has been noted since the last time."""
        news, self._news = self._news, {}
        return news


@contextlib.contextmanager
def _connected(address: str | None, workers: int | None) -> Iterator[None]:
    """Be connected to a cluster, without an address to one of this machine alone; InputError if none is."""
    # Nobody is told of what is run here.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    options |= {"runtime_env": {"env_vars": ONE_THREAD | variable_elsewhere()}}
    if address is None:
        options |= {"num_cpus": workers, "include_dashboard": False}
    try:
        _require_listener(address)
        ray.init(address=address or "local", **options)
    except (OSError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:200]
        place = "here" if address is None else f"at {shown(address)}"
        raise InputError(f"no Ray cluster could be reached {place}: {reason.rstrip('.')}.") from None
    try:
        yield
    finally:
        ray.shutdown()


def _require_listener(address: str | None) -> None:
    """Raise OSError unless somebody listens at HOST:PORT: Ray itself would wait for minutes."""
    host, _, port = (address or "").rpartition(":")
    if host and port.isdigit() and "/" not in host:
        socket.create_connection((host, int(port)), timeout=_LISTENING).close()


def _make_board() -> Any:
    """Return a board on the node of this process, which lives as long."""
    here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=True)
    return ray.remote(num_cpus=0, max_restarts=-1)(_Board).options(scheduling_strategy=here).remote()


def _pass_on(board: Any, running: dict[str, Job], watch: Watch) -> None:
    """Tell what the jobs have noted; a board that cannot be reached has no news."""
    try:
        news = ray.get(board.news.remote(), timeout=_LOOK)
    except ray.exceptions.RayError:
        return
    for key, done in news.items():
        if job := running.get(key):
            watch.begun(job)
            watch.at(job, done)


def _outcome(task: Any, job: Job) -> Result | Failure:
    """Return what came of a task that has ended, however it ended."""
    try:
        outcome: Result | Failure = ray.get(task)
    except ray.exceptions.RayError as error:
        reason = " ".join(str(error).split())[:500]
        return Failure(
            job, f"Ray gave the job up after {_TRIES + 1} tries ({type(error).__name__}: {reason})."
        )
    return outcome


def _end(tasks: Sequence[Any]) -> None:
    """Ask the tasks to end and wait for them; an interrupt meanwhile ends them at once."""
    if not tasks:
        return
    try:
        for task in tasks:
            ray.cancel(task)
        ray.wait(tasks, num_returns=len(tasks), timeout=_SAVING)
    except BaseException:
        for task in tasks:
            ray.cancel(task, force=True)
        raise
