"""What a person sees of a running training: a bar in a terminal, lines in a pipe."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from robosim.learning.metrics import Metrics

_LINES = 50
"""Lines that a piped run prints at most, apart from the last."""
_SMOOTHING = 0.3
"""Weight of the latest row in the speed that the time left comes from."""


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
        TextColumn("{task.completed:,.0f}/{task.total:,.0f}  {task.fields[figures]}"),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("training", total=steps, figures="", stage="training")

        def show(row: Metrics) -> None:
            figures = f"{_figures(row)}  left {left(row)}"
            bar.update(task, completed=min(row.step, steps), figures=figures, stage=row.stage)

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


class _Lines:
    def __init__(self, steps: int, console: Console, left: _TimeLeft) -> None:
        self._steps = steps
        self._console = console
        self._left = left
        self._next = 0.0

    def __call__(self, row: Metrics) -> None:
        left = self._left(row)
        if row.step < min(self._next, self._steps):
            return
        self._next = row.step + self._steps / _LINES
        line = f"step {row.step}/{self._steps}  {row.stage}  {_figures(row)}  left {left}"
        self._console.print(line, highlight=False, soft_wrap=True)


def _figures(row: Metrics) -> str:
    own = "".join(f"{name.replace('_', ' ')} {value:.3g}  " for name, value in row.figures.items())
    return (
        f"pellets/1000 {1000.0 * row.delivered / row.decisions:.1f}  blocked {row.blocked:.0%}  "
        f"collisions {row.collisions:.2f}  reward {row.reward:+.3f}  {own}{row.steps_per_second:.0f} steps/s"
    )
