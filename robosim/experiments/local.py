"""Many jobs on this machine: a process for each, some at a time, on one core each."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import sys
import threading
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path

from robosim.errors import InputError
from robosim.experiments.jobs import Failure, Job, Work, attempt_job
from robosim.experiments.results import Result
from robosim.experiments.runner import Watch

ONE_THREAD = dict.fromkeys(
    (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "BLIS_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
        "NUMEXPR_NUM_THREADS",
    ),
    "1",
)
"""Variables of the environment that let libraries compute with one thread."""
_SPAWN = multiprocessing.get_context("spawn")
_LOOK = 1.0
"""Time between two looks, s. A signal that comes just before a wait begins does not end that wait."""


@dataclass(frozen=True, slots=True)
class _Running:
    job: Job
    process: SpawnProcess
    answer: Connection


class LocalEngine:
    """Works off jobs in processes of this machine."""

    def __init__(self, workers: int = 1) -> None:
        """`workers` jobs run at a time; InputError unless there is one at least."""
        if workers < 1:
            raise InputError(f"workers is {workers}, but must be a whole number from 1 on.")
        self.workers = workers

    def run(
        self, jobs: Iterable[Job], work: Work, root: Path, watch: Watch
    ) -> Generator[Result | Failure, None, None]:
        """Yield what comes of each job; those at work are asked to end by SIGTERM."""
        waiting, running = iter(jobs), list[_Running]()
        try:
            while True:
                while len(running) < self.workers and (job := next(waiting, None)):
                    watch.begun(job)
                    # A job that is left between its start and the list would be asked to end by nobody.
                    with _interrupts_wait():
                        running.append(_start(job, work, root))
                if not running:
                    return
                answered = wait([one.answer for one in running], timeout=_LOOK)
                for one in [one for one in running if one.answer in answered]:
                    answer = _answer(one)
                    if isinstance(answer, float):
                        watch.at(one.job, answer)
                        continue
                    running.remove(one)
                    yield answer
        finally:
            _end(running)


def _start(job: Job, work: Work, root: Path) -> _Running:
    answer, far = _SPAWN.Pipe(duplex=False)
    process = _SPAWN.Process(target=_work_off, args=(job, work, root, far), name=f"job {job.key[:16]}")
    with _environment(ONE_THREAD):
        process.start()
    # The only other end is then the job's: it closes when the process ends, however it ends.
    far.close()
    return _Running(job, process, answer)


def _answer(one: _Running) -> Result | Failure | float:
    """Return what a job answered: its end, or the share that is done; else how its process ended."""
    answer: Result | Failure | float | None = None
    # A job that is killed in the midst of an answer leaves a part of it.
    with contextlib.suppress(EOFError, OSError, pickle.UnpicklingError):
        answer = one.answer.recv()
    if isinstance(answer, float):
        return answer
    one.answer.close()
    one.process.join()
    if answer is not None:
        return answer
    code = one.process.exitcode or 0
    how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
    return Failure(one.job, f"the process of the job {how}.")


def _end(running: Sequence[_Running]) -> None:
    """Ask the processes to end and wait for them; an interrupt meanwhile ends them at once."""
    try:
        for one in running:
            one.process.terminate()
        for one in running:
            while one.process.is_alive():
                one.process.join(_LOOK)
    except BaseException:
        for one in running:
            one.process.kill()
        raise


def _work_off(job: Job, work: Work, root: Path, answer: Connection) -> None:
    """Do a job in a process of its own, and answer with its result or with what went wrong."""
    # Ctrl-C in a terminal goes to all processes of a group: here, only the one above decides.
    os.setpgid(0, 0)
    threading.Thread(target=_end_with_parent, daemon=True).start()

    def report(done: float) -> None:
        # Nobody listens any more where the process above is gone; this one is then asked to end.
        with contextlib.suppress(OSError):
            answer.send(float(done))

    try:
        answer.send(attempt_job(job, work, root, report))
    except KeyboardInterrupt:
        sys.exit(130)


def _end_with_parent() -> None:
    """Ask this process to end when the one above is gone: two must not work off the same job."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os.kill(os.getpid(), signal.SIGTERM)


@contextlib.contextmanager
def _interrupts_wait() -> Iterator[None]:
    """Keep what SIGINT and SIGTERM would raise in this thread until the end of the block."""
    if threading.current_thread() is not threading.main_thread():
        # Their handlers run in the main thread.
        yield
        return
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    came = list[signal.Signals]()
    # One that is ignored or ends this process stays as it is: the new process is to have the same.
    held = {number: handler for number, handler in handlers.items() if callable(handler)}
    for number in held:
        signal.signal(number, lambda number, _frame: came.append(signal.Signals(number)))
    try:
        yield
    finally:
        for number, handler in held.items():
            signal.signal(number, handler)
    for number in came:
        signal.raise_signal(number)


@contextlib.contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    """Set variables of the environment; a process that is spawned has them before any library loads."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
