"""What a person sees of a running training: a bar in a terminal, lines in a pipe."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from robosim.learning.metrics import Metrics

_LINES = 50
"""Lines that a piped run prints at most, apart from the last."""


@contextmanager
def show_progress(steps: int, console: Console | None = None) -> Iterator[Callable[[Metrics], None]]:
    """Yield a function that shows the latest metrics of a run of `steps` joint decisions."""
    console = console or Console()
    if not console.is_terminal:
        yield _Lines(steps, console)
        return
    columns = (
        TextColumn("training"),
        BarColumn(),
        TextColumn("{task.completed:,.0f}/{task.total:,.0f}"),
        TextColumn("{task.fields[figures]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("training", total=steps, figures="")
        yield lambda row: bar.update(task, completed=min(row.step, steps), figures=_figures(row))


class _Lines:
    def __init__(self, steps: int, console: Console) -> None:
        self._steps = steps
        self._console = console
        self._next = 0.0

    def __call__(self, row: Metrics) -> None:
        if row.step < min(self._next, self._steps):
            return
        self._next = row.step + self._steps / _LINES
        line = f"step {row.step}/{self._steps}  {_figures(row)}"
        self._console.print(line, highlight=False, soft_wrap=True)


def _figures(row: Metrics) -> str:
    return (
        f"epsilon {row.epsilon:.2f}  loss {row.loss:.3g}  reward {row.reward:+.3f}  "
        f"pellets/1000 {1000.0 * row.delivered / row.decisions:.1f}  {row.steps_per_second:.0f} steps/s"
    )
