"""A job: one configuration to be worked off, known by a key, in a folder of its own that it goes on in."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from robosim.errors import InputError
from robosim.experiments.results import Result, this_machine
from robosim.files import alone_in, write_whole

CONFIG_FILE = "config.json"
WORK_FOLDER = "work"


@dataclass(frozen=True)
class Job:
    """One configuration: whatever JSON can hold, by names."""

    config: Mapping[str, Any]

    @cached_property
    def key(self) -> str:
        """SHA-256 of the configuration's canonical JSON: the same for equal ones, in any order of names."""
        return hashlib.sha256(canonical(self.config).encode()).hexdigest()

    def folder(self, root: Path) -> Path:
        """Return the job's folder among those of all jobs."""
        return root / self.key[:16]


@dataclass(frozen=True, slots=True)
class Outcome:
    """What comes of a job."""

    figures: Mapping[str, Sequence[float]]
    """By name, one number for each episode."""
    wall_time: float
    """Time spent on it, all parts of an interrupted job together, s."""


Work = Callable[[Mapping[str, Any], Path], Outcome]
"""Works off a configuration in a folder. Called again in the same folder it goes on, or finds its outcome."""


def canonical(config: Mapping[str, Any]) -> str:
    """Return JSON that is the same for equal configurations; InputError for what JSON cannot hold."""
    try:
        return json.dumps(config, sort_keys=True, separators=(",", ":"), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"a job's configuration must be numbers, texts, lists and tables: {error}."
        ) from None


def run_job(job: Job, work: Work, root: Path) -> Result:
    """Work a job off, or go on with it, in its folder below `root`, and return its record.

    InputError when another process is at it.
    """
    folder = job.folder(root)
    (folder / WORK_FOLDER).mkdir(parents=True, exist_ok=True)
    with alone_in(folder):
        write_whole(folder / CONFIG_FILE, json.dumps(job.config, indent=2) + "\n")
        outcome = work(job.config, folder / WORK_FOLDER)
    figures = {name: tuple(map(float, values)) for name, values in outcome.figures.items()}
    return Result(job.key, dict(job.config), figures, outcome.wall_time, this_machine())
