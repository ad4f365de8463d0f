"""A job: one configuration to be worked off, known by a key, in a folder of its own that it goes on in."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from robosim.errors import InputError
from robosim.experiments.keys import key_of
from robosim.experiments.results import Result, this_machine
from robosim.files import alone_in, write_whole

CONFIG_FILE = "config.json"
WORK_FOLDER = "work"
DIGITS = 6
"""Significant digits of the numbers in a record."""


@dataclass(frozen=True)
class Job:
    """One configuration: whatever JSON can hold, by names."""

    config: Mapping[str, Any]

    @cached_property
    def key(self) -> str:
        """What `key_of` makes of the configuration."""
        return key_of(self.config)

    def folder(self, root: Path) -> Path:
        """Return the job's folder among those of all jobs."""
        return root / self.key[:16]


@dataclass(frozen=True, slots=True)
class Outcome:
    """What comes of a job."""

    figures: Mapping[str, Sequence[float]]
    """By name, one number for each episode."""
    wall_time: float
    """Time spent learning, all parts of an interrupted job together, s."""
    series: Mapping[str, Sequence[float]] = field(default_factory=dict)
    """By name, numbers of which there are not as many as episodes."""
    evaluation_time: float = 0.0
    """Time spent on the evaluation, s."""
    gpu: str = ""
    """On which networks learned; empty where they did on the processor."""


@dataclass(frozen=True, slots=True)
class Failure:
    """A job that did not end well."""

    job: Job
    reason: str
    """A sentence, or a traceback."""


Report = Callable[[float], None]
"""Called with the share of a job that is done, 0 to 1."""
Work = Callable[[Mapping[str, Any], Path, Report], Outcome]
"""Works off a configuration in a folder. Called again in the same folder it goes on, or finds its outcome."""


def ignore(_done: float) -> None:
    """Report nothing."""


def run_job(job: Job, work: Work, root: Path, report: Report = ignore, patience: float = 0.0) -> Result:
    """Work a job off, or go on with it, in its folder below `root`, and return its record.

    InputError when another process is at it, and still is after `patience` (s).
    """
    folder = job.folder(root)
    with _alone(folder, patience):
        write_whole(folder / CONFIG_FILE, json.dumps(job.config, indent=2) + "\n")
        outcome = work(job.config, folder / WORK_FOLDER, report)
    return Result(
        key=job.key,
        config=dict(job.config),
        figures=_rounded(outcome.figures),
        series=_rounded(outcome.series),
        wall_time=round(outcome.wall_time, 3),
        evaluation_time=round(outcome.evaluation_time, 3),
        machine=this_machine() | ({"gpu": outcome.gpu} if outcome.gpu else {}),
    )


def attempt_job(
    job: Job, work: Work, root: Path, report: Report = ignore, patience: float = 0.0
) -> Result | Failure:
    """Run a job as `run_job` does; whatever goes wrong is a failure, so that other jobs go on."""
    try:
        return run_job(job, work, root, report, patience)
    except InputError as error:
        return Failure(job, str(error))
    except Exception:  # noqa: BLE001 - whatever it is, the other jobs go on
        return Failure(job, traceback.format_exc())


def remove_folder(job: Job, root: Path) -> None:
    """Remove a job's folder below `root`, if there is one and no other process is at work in it."""
    folder = job.folder(root)
    # Its name changes at once, while it is held: whoever comes next finds a whole folder or none.
    gone = folder.with_name(f".{folder.name}.{os.getpid()}.gone")
    with contextlib.suppress(InputError, OSError), alone_in(folder):
        folder.rename(gone)
    shutil.rmtree(gone, ignore_errors=True)


@contextlib.contextmanager
def _alone(folder: Path, patience: float) -> Iterator[None]:
    """Make a job's folder and hold it; errors as in `alone_in`."""
    while True:
        folder.mkdir(parents=True, exist_ok=True)
        with contextlib.ExitStack() as stack:
            try:
                before = folder.stat()
                stack.enter_context(alone_in(folder, patience))
                same = os.path.samestat(before, folder.stat())
            except FileNotFoundError:
                same = False
            # Else another process has removed it meanwhile, and what is held is no longer there.
            if same:
                (folder / WORK_FOLDER).mkdir(exist_ok=True)
                yield
                return


def _rounded(rows: Mapping[str, Sequence[float]]) -> dict[str, tuple[float, ...]]:
    """Return the numbers to as many digits as anybody reads: records are kept with the code."""
    return {name: tuple(float(f"{float(value):.{DIGITS}g}") for value in row) for name, row in rows.items()}
