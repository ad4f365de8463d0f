"""How far a long command has come: on stderr, in a terminal alone, so that what is piped stays the same."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from robosim.envs.vector import VectorEnv

_Item = TypeVar("_Item")
Show = Callable[[int, str], None]
"""Told how much is done, and the figures that matter."""


@contextlib.contextmanager
def progress(doing: str, total: int | None = None) -> Iterator[Show]:
    """Show a bar for as long as the block takes; one without an end where the `total` is not known."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield _show_nothing
        return
    known = [TextColumn("{task.percentage:>3.0f} %  left"), TimeRemainingColumn()] if total else []
    columns = [TextColumn(doing), BarColumn(bar_width=30), *known, TextColumn("{task.fields[figures]}")]
    # Gone at the end. What is printed meanwhile must stay where it goes, which may be a pipe.
    with Progress(*columns, console=console, transient=True, redirect_stdout=False) as bar:
        task = bar.add_task("", total=total, figures="")
        yield lambda done, figures: bar.update(task, completed=done, figures=figures)


def _show_nothing(done: int, figures: str) -> None:
    """Take the place of a bar where nobody would see it."""


def each(doing: str, items: Iterable[_Item], total: int | None = None) -> Iterator[_Item]:
    """Yield items that take long to come, with a bar while one is awaited, and none while it is printed.

    `total` is how many there are, if that is known.
    """
    iterator, done = iter(items), 0
    while True:
        try:
            with progress(doing, total) as show:
                show(done, f"case {done + 1}" + (f" of {total}" if total else ""))
                item = next(iterator)
        except StopIteration:
            return
        yield item
        done += 1


class EpisodesShown:
    """Sees the episodes of an evaluation, and shows how many decisions of them are taken."""

    def __init__(self, show: Show) -> None:
        self._show = show
        self._taken = 0

    def begin(self, env: VectorEnv) -> None:
        """Do nothing: there is nothing to show before the first decision."""

    def step(self, env: VectorEnv) -> None:
        self._taken += 1
        if self._taken % 20 == 0:
            self._show(self._taken, f"{env.delivered.sum() / env.num_envs:.1f} pellets an episode so far")

    def end(self, env: VectorEnv, wanted: int) -> None:
        """Do nothing: the next round goes on with the same bar."""


@contextlib.contextmanager
def episodes_shown(env: VectorEnv, episodes: int) -> Iterator[EpisodesShown]:
    """Give what sees the episodes of an evaluation in `env`, and shows them as they go on."""
    rounds = -(-episodes // env.num_envs)
    with progress("evaluating", rounds * env.episode_steps) as show:
        yield EpisodesShown(show)
