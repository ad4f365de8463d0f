"""`robosim sweep`: many runs that a file asks for, some at a time; stopped, it goes on."""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from robosim.cli.program import hint
from robosim.cli.tables import print_json
from robosim.errors import without_controls

if TYPE_CHECKING:
    from robosim.experiments import sweep
    from robosim.experiments.results import Result
    from robosim.experiments.runner import Engine


@dataclass(frozen=True)
class Sweep:
    """Train and measure many teams, as a file says (docs/sweeps.md). Stopped, the same command goes on."""

    file: Annotated[Path, tyro.conf.Positional]
    """The sweep (.toml)."""
    out: Path | None = None
    """Folder for the runs; by default runs/sweep-NAME."""
    results: Path | None = None
    """File to which a line of JSON is added for each finished run; by default NAME.results.jsonl beside the
    sweep. Runs that it holds are not run again."""
    engine: Literal["local", "ray"] = "local"
    """Processes of this machine, or a Ray cluster."""
    workers: int | None = None
    """Runs at a time, on a core each; by default as many as there are cores."""
    device: str | None = None
    """Where networks learn, of algorithms that have the option: cpu, or cuda for a GPU that all runs share.
    Runs are known by the same key wherever they learn; a record names the GPU."""
    address: str | None = None
    """Ray cluster, HOST:PORT or auto; by default Ray starts on this machine."""
    dry_run: bool = False
    """Only say which runs there are, which are done, and about how long the rest takes."""
    json: bool = False
    """With --dry-run, print the runs as JSON."""
    only: Annotated[str | None, tyro.conf.arg(metavar="NAME=VALUE,...")] = None
    """Only the runs with these values; several values of a name are alternatives."""
    keep_runs: bool = True
    """By default the folders of finished runs are kept, with policy and metrics; with this they go."""

    def run(self) -> None:
        """Work the sweep off, with a progress display, or say what there is to do."""
        from robosim.errors import InputError, whole_number
        from robosim.experiments.results import read_results
        from robosim.experiments.sweep import read_sweep

        if self.workers is not None:
            whole_number("--workers", self.workers, 1, 4096)
        if self.device is not None:
            if self.engine != "local":
                raise InputError("--device is for the processes of this machine: it needs --engine local.")
            from robosim.learning.computing import find_device

            find_device(self.device)
        if self.address is not None and self.engine != "ray":
            raise InputError("--address names a Ray cluster: it needs --engine ray.")
        if self.json and not self.dry_run:
            raise InputError("--json prints the list of runs: it needs --dry-run.")
        whole = plan = read_sweep(self.file)
        if self.only is not None:
            plan = whole.only(self.only)
        results = self.results or self.file.with_suffix(".results.jsonl")
        known = read_results(results)
        # Runs that are left out now tell, too, how long the others take.
        done = {job.key: known[job.key] for job in whole.jobs if job.key in known}
        if self.dry_run:
            self._show(plan, done)
        else:
            self._work_off(plan, results, done)

    def _work_off(self, plan: sweep.Sweep, results: Path, done: Mapping[str, Result]) -> None:
        from robosim.errors import IncompleteError
        from robosim.experiments.display import Display
        from robosim.experiments.runner import run_jobs
        from robosim.experiments.team import work_off

        work = partial(work_off, device=self.device)
        out = self.out or Path("runs") / f"sweep-{self.file.stem}"
        labels = {run.job.key: run.label for run in plan.runs if run.job is not None}
        others = [result for key, result in done.items() if key not in labels]
        engine = self._engine()
        try:
            with Display(labels, plan.jobs, others=others) as display:
                summary = run_jobs(plan.jobs, work, out.absolute(), results, engine, display, self.keep_runs)
        except KeyboardInterrupt:
            print(f"Stopped; go on with: {hint(*sys.argv[1:])}")
            raise
        count = len(plan.jobs) - len(summary.failures)
        print(f"{_counted(count, 'run')} done, {_skipped(plan)} skipped; results in {results}")
        for failure in summary.failures:
            print(f"{without_controls(labels[failure.job.key])}: {_lines(failure.reason)}", file=sys.stderr)
        if summary.failures:
            raise IncompleteError(
                f"{_counted(len(summary.failures), 'run')} failed; the same command tries again."
            )

    def _engine(self) -> Engine:
        if self.engine == "ray":
            from robosim.experiments.ray_engine import RayEngine

            return RayEngine(self.address, self.workers)
        from robosim.experiments.local import LocalEngine

        return LocalEngine(self._local_workers)

    @property
    def _local_workers(self) -> int:
        return self.workers or len(os.sched_getaffinity(0))

    def _show(self, plan: sweep.Sweep, done: Mapping[str, Result]) -> None:
        """Print each run with what is to be done about it, how many there are, and how long they take.

        `done` are records of the whole sweep, by which the rest is judged.
        """
        from robosim.experiments.forecast import Forecast
        from robosim.learning.progress import clock

        states = [_state(run, done) for run in plan.runs]
        if self.json:
            print_json([_record(run, state) for run, state in zip(plan.runs, states, strict=True)])
            return
        for run, state in zip(plan.runs, states, strict=True):
            print(without_controls(f"{state:<8} {run.label}{f': {run.skip}' if run.skip else ''}"))
        counts = Counter(states)
        print(", ".join(f"{counts[state]} {state}" for state in ("done", "to do", "skipped")))
        waiting = [job.config for job in plan.jobs if job.key not in done]
        seconds = Forecast(done.values()).left(waiting, [], self._local_workers)
        if seconds is None:
            print("no run is done yet that would tell how long the rest takes")
        elif waiting:
            at_once = f"{self._local_workers} at a time"
            print(f"about {clock(seconds)} to go, {at_once}, by the {_counted(len(done), 'run')} done")


def _state(run: sweep.Run, results: Mapping[str, Result]) -> str:
    if run.job is None:
        return "skipped"
    return "done" if run.job.key in results else "to do"


def _record(run: sweep.Run, state: str) -> dict[str, Any]:
    """Return what the list says of a run, for other programs."""
    return {
        "run": run.label,
        "values": dict(run.names),
        "state": state,
        "key": None if run.job is None else run.job.key,
        "why": run.skip or None,
    }


def _lines(reason: str) -> str:
    """Return why a run failed, which may be a traceback, in lines that steer no terminal."""
    return "\n".join(map(without_controls, reason.strip().splitlines()))


def _skipped(plan: sweep.Sweep) -> int:
    return sum(run.job is None for run in plan.runs)


def _counted(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
