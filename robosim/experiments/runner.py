"""Many jobs, by whatever engine: those without a record are worked off, and a file gets a line for each."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from robosim.errors import InputError
from robosim.experiments.jobs import Failure, Job, Outcome, Report, Work, remove_folder
from robosim.experiments.keys import key_of
from robosim.experiments.results import Result, ResultsFile, append_result, read_results
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
        """Hear that a job has ended, well or not; or that another process has done it meanwhile."""


class Engine(Protocol):
    """Works off jobs somewhere, some at a time."""

    def run(
        self, jobs: Iterable[Job], work: Work, root: Path, watch: Watch
    ) -> Generator[Result | Failure, None, None]:
        """Yield what comes of each job, once, in whatever order they end.

        The next job is asked for only once there is room for it: which one that is may change until then.
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
    then its folder is removed, unless they are to be kept. Several processes may work off the same jobs:
    what another has recorded meanwhile is not done again, and one at which another is at work fails. One that
    fails stops no other. Interrupted, KeyboardInterrupt is raised once the jobs at work have saved; the next
    call goes on.

    `work` must be importable by name, and a script that calls this guarded by `__name__ == "__main__"`.
    """
    require_writable(results)
    file = ResultsFile(results)
    done = file.read()
    try:
        root.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{root}: no folder can be made here: {error.strerror or error}.") from None
    every = {job.key: job for job in jobs}
    watch = watch or Watch()
    watch.known([done[key] for key in every if key in done])
    left = [job for key, job in every.items() if key not in done]
    failures: list[Failure] = []

    def waiting() -> Iterator[Job]:
        for job in left:
            done.update(_more(file))
            if job.key in done:
                watch.ended(job, done[job.key])
            else:
                yield job

    once = partial(_unless_recorded, work, results.absolute())
    with closing(engine.run(waiting(), once, root, watch)) as outcomes:
        for outcome in outcomes:
            if isinstance(outcome, Failure):
                failures.append(outcome)
                watch.ended(outcome.job, outcome)
                continue
            done.update(_more(file))
            if outcome.key not in done:
                append_result(results, outcome)
                done[outcome.key] = outcome
            watch.ended(every[outcome.key], done[outcome.key])
            if not keep:
                remove_folder(every[outcome.key], root)
    if failures:
        # Such as those at which another process was at work, if it has done them since.
        done.update(_more(file))
        failures = [failure for failure in failures if failure.job.key not in done]
    return Summary([done.get(job.key) for job in jobs], failures)


def _unless_recorded(
    work: Work, results: Path, config: Mapping[str, Any], folder: Path, report: Report
) -> Outcome:
    """Work a job off, while its folder is held, unless a process that held it before has recorded it."""
    with suppress(InputError):
        if found := read_results(results).get(key_of(config)):
            return Outcome(found.figures, found.wall_time, found.series, found.evaluation_time)
    return work(config, folder, report)


def _more(file: ResultsFile) -> dict[str, Result]:
    """Return the results in a file; none where somebody has damaged it, which must not stop those at work."""
    with suppress(InputError):
        return file.read()
    return {}
