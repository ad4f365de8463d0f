"""Many jobs on this machine: a process for each, some at a time, on one core each."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path

from robosim.errors import InputError
from robosim.experiments.jobs import Job, Work, run_job
from robosim.experiments.results import Result, append_result, read_results
from robosim.files import require_writable

Progress = Callable[[int, int], None]
"""Called with the number of jobs that have ended, and of all."""

_ONE_THREAD = dict.fromkeys(
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
_SPAWN = multiprocessing.get_context("spawn")


@dataclass(frozen=True, slots=True)
class Failure:
    """A job that did not end well."""

    job: Job
    reason: str
    """A sentence, or a traceback."""


@dataclass(frozen=True, slots=True)
class Summary:
    """What came of jobs."""

    results: Sequence[Result | None]
    """One for each job, in their order; None for those that failed."""
    failures: Sequence[Failure]


@dataclass(frozen=True, slots=True)
class _Running:
    job: Job
    process: SpawnProcess
    answer: Connection


def run_local(
    jobs: Sequence[Job],
    work: Work,
    root: Path,
    results: Path,
    workers: int = 1,
    progress: Progress | None = None,
) -> Summary:
    """Work off all jobs that have no result yet, `workers` at a time, and return what came of all.

    Each job has a folder below `root`, in which it goes on, and adds a line to `results` once it is done.
    One that fails stops no other. Interrupted, the jobs at work are asked to end (SIGTERM) and waited for,
    and KeyboardInterrupt is raised; the next call goes on. A second interrupt does not wait.

    `work` must be importable by name, and a script that calls this guarded by `__name__ == "__main__"`.
    """
    if workers < 1:
        raise InputError(f"workers is {workers}, but must be a whole number from 1 on.")
    root.mkdir(parents=True, exist_ok=True)
    require_writable(results)
    known = read_results(results)
    every = {job.key: job for job in jobs}
    waiting = [job for key, job in every.items() if key not in known]
    failures: list[Failure] = []
    running: list[_Running] = []
    ended = len(every) - len(waiting)
    report = progress or _ignore
    report(ended, len(every))
    waiting.reverse()
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                running.append(_start(waiting.pop(), work, root))
            answered = wait([one.answer for one in running])
            for one in [one for one in running if one.answer in answered]:
                running.remove(one)
                result = _answer(one)
                if isinstance(result, Failure):
                    failures.append(result)
                else:
                    append_result(results, result)
                    known[result.key] = result
                ended += 1
                report(ended, len(every))
    finally:
        _end(running)
    return Summary([known.get(job.key) for job in jobs], failures)


def _ignore(_ended: int, _total: int) -> None:
    """Report nothing."""


def _start(job: Job, work: Work, root: Path) -> _Running:
    answer, far = _SPAWN.Pipe(duplex=False)
    process = _SPAWN.Process(target=_work_off, args=(job, work, root, far), name=f"job {job.key[:16]}")
    with _environment(_ONE_THREAD):
        process.start()
    # The only other end is then the job's: it closes when the process ends, however it ends.
    far.close()
    return _Running(job, process, answer)


def _answer(one: _Running) -> Result | Failure:
    """Return what a job answered, or how its process ended without a word."""
    try:
        answer: Result | str = one.answer.recv()
    except EOFError:
        answer = ""
    one.answer.close()
    one.process.join()
    if isinstance(answer, Result):
        return answer
    code = one.process.exitcode or 0
    how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
    return Failure(one.job, answer or f"the process of the job {how}.")


def _end(running: Sequence[_Running]) -> None:
    """Ask the processes to end and wait for them; an interrupt meanwhile ends them at once."""
    try:
        for one in running:
            one.process.terminate()
        for one in running:
            one.process.join()
    except BaseException:
        for one in running:
            one.process.kill()
        raise


def _work_off(job: Job, work: Work, root: Path, answer: Connection) -> None:
    """Do a job in a process of its own, and answer with its result or with what went wrong."""
    # Ctrl-C in a terminal goes to all processes of a group: here, only the one above decides.
    os.setpgid(0, 0)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        result: Result | str = run_job(job, work, root)
    except InputError as error:
        result = str(error)
    except KeyboardInterrupt:
        sys.exit(130)
    except Exception:  # noqa: BLE001 - whatever it is, the other jobs go on
        result = traceback.format_exc()
    answer.send(result)


def _end_with_parent() -> None:
    """Ask this process to end when the one above is gone: two must not work off the same job."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os.kill(os.getpid(), signal.SIGTERM)


@contextmanager
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
