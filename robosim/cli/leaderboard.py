"""`robosim leaderboard`: what systems deliver, by arena and team size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from robosim.cli.tables import aligned, markdown, written
from robosim.errors import InputError, nearest_names, shown, without_controls

if TYPE_CHECKING:
    from robosim.experiments.leaderboard import Entry
    from robosim.experiments.leaderboard import Leaderboard as Board

_COLUMNS = ("rank", "system", "kind", "seeds", "learned", "pellets, 95 % interval", "of lanes", "from")


@dataclass(frozen=True)
class Leaderboard:
    """Rank systems by the pellets that their teams deliver: arena by arena, team size by team size."""

    records: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FILE...")] = ()
    """Results of your own, beside those of robosim: files of sweeps, run folders or folders with some below
    them, files of `evaluate --json`."""
    arena: str | None = None
    """Only this arena, by its name in the records."""
    robots: int | None = None
    """Only teams of this size."""
    markdown: bool = False
    """Print the tables as Markdown."""
    into: Annotated[Path | None, tyro.conf.arg(metavar="PAGE.md")] = None
    """Page whose tables these replace: all from its first heading of the second level on."""
    json: Path | None = None
    """File to write all numbers to."""

    def run(self) -> None:
        """Read all records and cards, and print a table for each task."""
        import json

        from robosim.control.card import read_card
        from robosim.control.policy import CARD_FILE, find_policy, policy_names
        from robosim.experiments.leaderboard import Leaderboard as Board
        from robosim.experiments.leaderboard import committed_records, leaderboard
        from robosim.files import require_apart, require_writable, write_whole

        require_apart({"--json": self.json, "--into": self.into}, self.records)
        if self.json is not None:
            require_writable(self.json)
        policies = {name: read_card(find_policy(name) / CARD_FILE) for name in policy_names()}
        own = committed_records()
        board = leaderboard(own, policies, self.records)
        notes = list(board.notes)
        if not own:
            notes.append(
                "This installation has no records of robosim's own runs: a checkout has, in docs/results."
            )
        asked = [entry for entry in board.entries if self._asked(entry)]
        if not asked:
            raise InputError(self._nothing(board.entries))
        board = Board(asked, notes)
        if self.into is not None:
            self._write_into(self.into, board)
        else:
            print("\n".join(lines_of(board, self.markdown)))
        if self.json is not None:
            write_whole(self.json, json.dumps(board.as_record(), indent=2, allow_nan=False) + "\n")

    def _write_into(self, page: Path, board: Board) -> None:
        from robosim.files import write_whole

        try:
            before, heading, _ = page.read_text(encoding="utf-8").partition("\n## ")
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"{page}: cannot be read as a page ({error}).") from None
        if not heading:
            raise InputError(
                f"{page}: has no heading of the second level, from which on it could be replaced."
            )
        write_whole(page, "\n".join([before, *lines_of(board, in_markdown=True), ""]))
        print(f"written: {page}")

    def _asked(self, entry: Entry) -> bool:
        arena = self.arena is None or entry.task.arena == self.arena
        return arena and (self.robots is None or entry.task.robots == self.robots)

    def _nothing(self, entries: Sequence[Entry]) -> str:
        """Return why there is no entry: for which arena, or which team size in it, there is none."""
        arenas = {entry.task.arena for entry in entries}
        if not arenas:
            return "there is no record and no policy: give --records."
        if self.arena is not None and self.arena not in arenas:
            return f"--arena: there is no entry for {shown(self.arena)}: {nearest_names(self.arena, arenas)}"
        sizes = sorted({one.task.robots for one in entries if self.arena in (None, one.task.arena)})
        return f"--robots is {self.robots}, but there are entries for {', '.join(map(str, sizes))} alone."


def lines_of(board: Board, in_markdown: bool = False) -> list[str]:
    """Return the leaderboard as lines of text: a table for each task, then notes."""
    lines: list[str] = []
    for task, entries in board.by_task():
        rows = [_COLUMNS, *map(_cells, entries)]
        if in_markdown:
            lines += [f"## {task}", "", *markdown(rows), ""]
        else:
            lines += [f"{task}:", *aligned(rows), ""]
    lines = [*lines, *board.notes] if board.notes else lines[:-1]
    return list(map(without_controls, lines))


def _cells(entry: Entry) -> tuple[str, ...]:
    return (
        "-" if entry.rank is None else str(entry.rank),
        entry.system,
        entry.kind,
        str(entry.seeds),
        "-" if entry.steps is None else f"{entry.steps:,}",
        written(entry.pellets, 1),
        "-" if entry.share is None else f"{entry.share:.2f}",
        entry.source,
    )
