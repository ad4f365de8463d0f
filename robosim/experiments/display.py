"""What a person sees of a sweep at work: a bar for all and for each running job, or lines in a pipe."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn

from robosim.errors import without_controls
from robosim.experiments.forecast import Forecast, Running
from robosim.experiments.jobs import Failure, Job
from robosim.experiments.results import Result
from robosim.experiments.runner import Watch
from robosim.learning.progress import clock


@dataclass(slots=True)
class _AtWork:
    since: float
    before: float
    done: float
    bar: TaskID | None


class Display(Watch):
    """Shows how the jobs of a sweep come along; to be used in a `with` block."""

    def __init__(
        self,
        labels: Mapping[str, str],
        jobs: Sequence[Job],
        console: Console | None = None,
        others: Iterable[Result] = (),
    ) -> None:
        """`labels` name the jobs by their keys; `others` are records that tell how long such jobs take."""
        self._console = console or Console()
        self._labels = labels
        self._waiting = {job.key: job for job in jobs}
        self._total = len(self._waiting)
        self._running: dict[str, _AtWork] = {}
        self._jobs = dict(self._waiting)
        self._forecast = Forecast(others)
        self._workers = 1
        self._failed = 0
        self._bars: Progress | None = None
        self._all: TaskID | None = None
        if self._console.is_terminal:
            columns = (
                TextColumn("{task.description}"),
                BarColumn(bar_width=20),
                TextColumn("{task.fields[text]}"),
            )
            self._bars = Progress(*columns, console=self._console)

    def __enter__(self) -> Self:
        if self._bars is not None:
            self._bars.start()
            self._all = self._bars.add_task("all runs", total=max(1, self._total), text="")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        if self._bars is not None:
            self._bars.stop()

    def known(self, results: Sequence[Result]) -> None:
        for result in results:
            self._waiting.pop(result.key, None)
            self._forecast.add(result)
        if results:
            self._line(f"{len(results)} of {self._total} runs were done before")
        self._refresh()

    def begun(self, job: Job) -> None:
        self._waiting.pop(job.key, None)
        if job.key in self._running:
            return
        bar = self._bars.add_task(escape(self._label(job)), total=1.0, text="") if self._bars else None
        self._running[job.key] = _AtWork(time.monotonic(), 0.0, 0.0, bar)
        self._workers = max(self._workers, len(self._running))
        if self._bars is None:
            self._line(f"begun: {self._label(job)}")
        self._refresh()

    def at(self, job: Job, done: float) -> None:
        one = self._running.get(job.key)
        if one is None:
            return
        if one.done == 0.0 or done < one.done:
            # What it did before, and how long it took to begin, say nothing of its speed.
            one.since, one.before = time.monotonic(), done
        one.done = done
        if self._bars is not None and one.bar is not None:
            self._bars.update(one.bar, completed=done, text=f"{done:.0%}")
        self._refresh()

    def ended(self, job: Job, outcome: Result | Failure) -> None:
        one = self._running.pop(job.key, None)
        self._waiting.pop(job.key, None)
        if self._bars is not None and one is not None and one.bar is not None:
            self._bars.remove_task(one.bar)
        if isinstance(outcome, Failure):
            self._failed += 1
            what = f"failed: {without_controls(outcome.reason.strip().splitlines()[-1])}"
        else:
            self._forecast.add(outcome)
            what = _figures(outcome)
        line = f"{self._done}/{self._total}  {self._label(job)}  {what}"
        self._line(line if self._bars is not None else f"{line}  left {self._left()}")
        self._refresh()

    @property
    def _done(self) -> int:
        return self._total - len(self._waiting) - len(self._running)

    def _left(self) -> str:
        now = time.monotonic()
        running = [
            Running(self._jobs[key].config, now - one.since, one.before, one.done)
            for key, one in self._running.items()
        ]
        seconds = self._forecast.left(
            [job.config for job in self._waiting.values()], running, max(self._workers, len(running))
        )
        return "not known yet" if seconds is None else clock(seconds)

    def _refresh(self) -> None:
        if self._bars is not None and self._all is not None:
            failed = f"  {self._failed} failed" if self._failed else ""
            text = f"{self._done}/{self._total}{failed}  left {self._left()}"
            part = sum(one.done for one in self._running.values())
            self._bars.update(self._all, completed=self._done + part, text=text)

    def _label(self, job: Job) -> str:
        return without_controls(self._labels.get(job.key) or job.key[:16])

    def _line(self, text: str) -> None:
        self._console.print(text, highlight=False, soft_wrap=True, markup=False, emoji=False)


def _figures(result: Result) -> str:
    took = f"{result.wall_time + result.evaluation_time:.0f} s"
    pellets = result.figures.get("pellets", ())
    return f"{sum(pellets) / len(pellets):.1f} pellets  {took}" if pellets else took
