"""`robosim arena`: list the arenas that ship, show one, check a file, draw one at random."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from robosim.cli.tables import console, print_json, print_table
from robosim.errors import without_controls

if TYPE_CHECKING:
    from rich.console import Console

    from robosim.arena import Arena as ArenaData
    from robosim.robot.sheet import RobotSheet
    from robosim.robot.team import Group


@dataclass(frozen=True)
class List:
    """List the arenas that ship."""

    png: Path | None = None
    """Also draw them all to one scale into this PNG file."""
    json: bool = False
    """Print the list as JSON."""

    def run(self) -> None:
        from robosim.arena import arena_names, load_arena

        arenas = [load_arena(name) for name in arena_names()]
        _draw(arenas, self.png)
        if self.json:
            print_json([_record(arena) for arena in arenas])
            return
        rows = [
            (
                arena.name,
                "{:.2f} x {:.2f}".format(*arena.size),
                str(arena.capacity),
                str(arena.tunnel_length),
                arena.description,
            )
            for arena in arenas
        ]
        print_table(("arena", "size, m", "robots", "tunnel, cells", "what it is"), rows)


@dataclass(frozen=True)
class Show:
    """Show an arena: its map, sizes, distances and data sheet."""

    name: tyro.conf.Positional[str]
    """A shipped arena's name, or the path of an arena file."""
    png: Path | None = None
    """Also draw it to scale into this PNG file."""

    def run(self) -> None:
        from robosim.arena import load_arena

        arena = load_arena(self.name)
        _draw([arena], self.png)
        _show(arena, console())


@dataclass(frozen=True)
class Check:
    """Check an arena file, and name every mistake in it."""

    file: tyro.conf.Positional[str]
    """The arena file, or a shipped arena's name."""

    def run(self) -> None:
        from robosim.arena import load_arena

        arena = load_arena(self.file)
        print(
            f"{without_controls(self.file)}: ok: {arena.columns} x {arena.rows} cells, "
            f"room for {arena.capacity} robots, {arena.pellets.count} pellets"
        )


@dataclass(frozen=True)
class Random:
    """Draw an arena at random, as `robosim train --random-arenas` does, and show it."""

    seed: int = 0
    """Equal seeds give equal arenas."""
    save: Annotated[Path | None, tyro.conf.arg(metavar="FILE.toml")] = None
    """Also write it to this file, to be used wherever an arena is asked for."""
    png: Path | None = None
    """Also draw it to scale into this PNG file."""
    count: int = 1
    """Arenas in that picture: this one, and those of the seeds after it."""

    def run(self) -> None:
        from robosim.arena import load_arena
        from robosim.arena.random import random_arena
        from robosim.errors import whole_number
        from robosim.files import write_whole

        count = whole_number("--count", self.count, 1, 100)
        text = random_arena(self.seed)
        if self.save is not None:
            write_whole(self.save, text)
        if self.png is not None and count > 1:
            from robosim.analysis.figures.arenas import save_gallery

            save_gallery([load_arena(random_arena(self.seed + more)) for more in range(count)], self.png)
        else:
            _draw([load_arena(text)], self.png)
        _show(load_arena(text), console())


@dataclass(frozen=True)
class Arena:
    """List the arenas that ship, show one, check an arena file, draw one at random."""

    do: Annotated[
        Annotated[List, tyro.conf.subcommand("list")]
        | Annotated[Show, tyro.conf.subcommand("show")]
        | Annotated[Check, tyro.conf.subcommand("check")]
        | Annotated[Random, tyro.conf.subcommand("random")],
        tyro.conf.arg(name=""),
    ]

    def run(self) -> None:
        self.do.run()


_STYLES = {
    "#": "white on bright_black",
    "H": "black on bright_cyan",
    "S": "black on bright_yellow",
    "X": "black on bright_magenta",
}


def _record(arena: ArenaData) -> dict[str, Any]:
    """Return what the list says of an arena, for other programs."""
    return {
        "name": arena.name,
        "size": list(arena.size),
        "robots": arena.capacity,
        "tunnel_cells": arena.tunnel_length,
        "description": arena.description,
    }


def _draw(arenas: list[ArenaData], path: Path | None) -> None:
    if path is not None:
        from robosim.analysis.figures.arenas import save_picture

        save_picture(arenas, path)


def _show(arena: ArenaData, out: Console) -> None:
    from rich.table import Table
    from rich.text import Text

    from robosim.arena.draw import drawing

    out.print(Text(arena.name, style="bold"))
    if arena.description:
        out.print("\n".join(map(without_controls, arena.description.splitlines())))
    out.print()
    for line in drawing(arena):
        coloured = Text.assemble(*((character, _STYLES.get(character, "default")) for character in line))
        out.print(coloured, soft_wrap=True)
    handover = "  X hand-over" if arena.handover is not None else ""
    out.print(f"# wall  . floor  H home  S source  T tunnel{handover}\n")
    table = Table.grid(padding=(0, 2))
    for name, value in _facts(arena):
        table.add_row(name, value)
    out.print(table)


def _sheet_facts(name: str, robot: RobotSheet) -> list[tuple[str, str]]:
    """Say in words what a data sheet holds."""
    extent = f"{robot.length} m" if robot.shape == "circle" else f"{robot.length} x {robot.width} m"
    return [
        (name, f"{robot.shape} of {extent}, {robot.mass} kg"),
        ("", f"top speed {robot.top_speed:.3g} m/s, top turn rate {robot.top_turn_rate:.3g} rad/s"),
        (
            "",
            f"wheels {robot.wheel_radius} m in radius, {robot.wheel_base} m apart, traction {robot.traction}",
        ),
        ("", f"gripper reaches {robot.gripper_reach} m and holds {robot.grip_force} N"),
    ]


def _group_facts(group: Group) -> list[tuple[str, str]]:
    """Say in words what a group of the team is."""
    share = f"{group.role}, {group.count} at a time as robots are dealt out to the groups"
    return [(group.name, share), *_sheet_facts("", group.sheet)]


def _facts(arena: ArenaData) -> list[tuple[str, str]]:
    """Say in words what the arena holds: (what, text) of each line."""
    width, height = arena.size
    pellets, timing = arena.pellets, arena.timing
    to_home, to_source = arena.distances.raster[..., 0], arena.distances.raster[..., 1]
    start = (
        f"{len(arena.start.poses)} given poses"
        if arena.start.poses
        else f"the {arena.start.zone.name.lower()}"
    )
    facts = [
        (
            "size",
            f"{arena.columns} x {arena.rows} cells of {arena.cell_size} m: {width:.2f} x {height:.2f} m",
        ),
        ("tunnel", f"{arena.tunnel_length} cells: {arena.tunnel_length * arena.cell_size:.2f} m long"),
        ("home to source", f"{to_source[to_home == 0.0].min():.2f} m at least"),
        ("robots", f"up to {arena.capacity}, starting from {start}"),
        *(_sheet_facts("robot", arena.robot) if not arena.groups else ()),
        *(fact for group in arena.groups for fact in _group_facts(group)),
        ("pellets", f"{pellets.count} of radius {pellets.radius} m, {pellets.mass} kg"),
        ("", f"friction {pellets.friction}, cohesion {pellets.cohesion} N"),
        ("decision", f"every {timing.decision_period} s, {timing.episode_steps} in an episode"),
        ("", f"{timing.control_steps} control periods of {timing.substeps} substeps"),
    ]
    for factor, (low, high) in asdict(arena.randomisation).items():
        if (low, high) != (1.0, 1.0):
            facts.append(("random", f"{factor} times {low} to {high}"))
    return facts
