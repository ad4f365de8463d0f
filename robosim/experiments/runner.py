"""Many jobs, by whatever engine: those without a record are worked off, and a file gets a line for each."""

from __future__ import annotations

import shutil
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from robosim.errors import InputError
from robosim.experiments.jobs import Failure, Job, Work
from robosim.experiments.results import Result, append_result, read_results
from robosim.files import require_writable


class Watch:
    """Hears how jobs come along; of this one nobody sees anything."""

    def known(self, results: Sequence[Result]) -> None:
        """Hear of the jobs that were done before."""

    def begun(self, job: Job) -> None:
        """Hear that a job has begun, or begun again."""

    def at(self, job: Job, done: float) -> None:
        """Hear which share of a running job is done, 0 to 1."""

    def ended(self, job: Job, outcome: Result | Failure) -> None:
        """Hear that a job has ended, well or not."""


class Engine(Protocol):
    """Works off jobs somewhere, some at a time."""

    def run(
        self, jobs: Sequence[Job], work: Work, root: Path, watch: Watch
    ) -> Generator[Result | Failure, None, None]:
        """Yield what comes of each job, once, in whatever order they end.

        Each is worked off in its folder below `root`. Closed or interrupted, those at work are asked to save
        and to end, and are waited for; a second interrupt does not wait.
        """
        ...


@dataclass(frozen=True, slots=True)
class Summary:
    """What came of jobs."""

    results: Sequence[Result | None]
    """One for each job, in their order; None for those that failed."""
    failures: Sequence[Failure]


def run_jobs(
    jobs: Sequence[Job],
    work: Work,
    root: Path,
    results: Path,
    engine: Engine,
    watch: Watch | None = None,
    keep: bool = True,
) -> Summary:
    """Work off all jobs that have no result yet, and return what came of all.

    Each job has a folder below `root`, in which it goes on, and adds a line to `results` once it is done;
    then its folder is removed, unless they are to be kept. One that fails stops no other. Interrupted,
    KeyboardInterrupt is raised once the jobs at work have saved; the next call goes on.

    `work` must be importable by name, and a script that calls this guarded by `__name__ == "__main__"`.
    """
    require_writable(results)
    done = read_results(results)
    try:
        root.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{root}: no folder can be made here: {error.strerror or error}.") from None
    every = {job.key: job for job in jobs}
    waiting = [job for key, job in every.items() if key not in done]
    watch = watch or Watch()
    watch.known([done[key] for key in every if key in done])
    failures: list[Failure] = []
    with closing(engine.run(waiting, work, root, watch)) as outcomes:
        for outcome in outcomes:
            if isinstance(outcome, Failure):
                failures.append(outcome)
                watch.ended(outcome.job, outcome)
                continue
            append_result(results, outcome)
            done[outcome.key] = outcome
            watch.ended(every[outcome.key], outcome)
            if not keep:
                shutil.rmtree(every[outcome.key].folder(root), ignore_errors=True)
    return Summary([done.get(job.key) for job in jobs], failures)
