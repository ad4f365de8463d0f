"""What a person sees of a running training: a bar in a terminal, lines in a pipe."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Column

from robosim.learning.metrics import Metrics

_LINES = 50
"""Lines that a piped run prints at most, apart from the last."""
_SMOOTHING = 0.3
"""Weight of the latest row in the speed that the time left comes from."""
_WINDOW = 20
"""Rows of the metrics that the pellets shown are the mean of."""


@contextmanager
def show_progress(steps: int, console: Console | None = None) -> Iterator[Callable[[Metrics], None]]:
    """Yield a function that shows the latest metrics of a run of `steps` joint decisions."""
    console = console or Console()
    left = _TimeLeft(steps)
    if not console.is_terminal:
        yield _Lines(steps, console, left)
        return
    columns = (
        TextColumn("{task.fields[stage]}"),
        BarColumn(bar_width=20),
        TextColumn("{task.completed:,.0f}/{task.total:,.0f}  left {task.fields[left]}"),
        # What a narrow terminal has no room for is left out here, not of the bar.
        TextColumn("{task.fields[figures]}", table_column=Column(ratio=1, no_wrap=True, overflow="ellipsis")),
    )
    with Progress(*columns, console=console, expand=True) as bar:
        task = bar.add_task("training", total=steps, figures="", stage="training", left="")
        pellets = _Pellets()

        def show(row: Metrics) -> None:
            figures = _figures(row, pellets(row))
            bar.update(task, completed=min(row.step, steps), figures=figures, stage=row.stage, left=left(row))

        yield show


def clock(seconds: float) -> str:
    """Return a time as minutes and seconds, from an hour on with hours before them."""
    whole = round(seconds)
    hours, minutes = divmod(whole // 60, 60)
    text = f"{minutes}:{whole % 60:02d}"
    return f"{hours}:{text:>05}" if hours else text


class _TimeLeft:
    """Estimates the time left from the speed of late."""

    def __init__(self, steps: int) -> None:
        self._steps = steps
        self._speed = 0.0

    def __call__(self, row: Metrics) -> str:
        part = _SMOOTHING if self._speed else 1.0
        self._speed += part * (row.steps_per_second - self._speed)
        return clock(max(0, self._steps - row.step) / max(self._speed, 1e-9))


class _Pellets:
    """Pellets in 1000 decisions of late.

    Environments begin their episodes together, with nothing to deliver yet: a row alone says little.
    """

    def __init__(self) -> None:
        self._rows: deque[Metrics] = deque(maxlen=_WINDOW)

    def __call__(self, row: Metrics) -> float:
        if self._rows and self._rows[-1].stage != row.stage:
            self._rows.clear()
        self._rows.append(row)
        return 1000.0 * sum(row.delivered for row in self._rows) / sum(row.decisions for row in self._rows)


class _Lines:
    def __init__(self, steps: int, console: Console, left: _TimeLeft) -> None:
        self._steps = steps
        self._console = console
        self._left = left
        self._next = 0.0
        self._pellets = _Pellets()

    def __call__(self, row: Metrics) -> None:
        left, pellets = self._left(row), self._pellets(row)
        if row.step < min(self._next, self._steps):
            return
        self._next = row.step + self._steps / _LINES
        line = f"step {row.step}/{self._steps}  {row.stage}  {_figures(row, pellets)}  left {left}"
        self._console.print(line, highlight=False, soft_wrap=True)


def _figures(row: Metrics, pellets: float) -> str:
    own = "".join(f"{name.replace('_', ' ')} {value:.3g}  " for name, value in row.figures.items())
    return (
        f"pellets/1000 {pellets:.1f}  blocked {row.blocked:.0%}  "
        f"collisions {row.collisions:.2f}  reward {row.reward:+.3f}  {own}{row.steps_per_second:.0f} steps/s"
    )
