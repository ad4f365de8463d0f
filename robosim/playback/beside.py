"""Runs of one team in one arena side by side, in one recording: the same start, in unlike worlds."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path

import rerun as rr

from robosim.arena.model import Arena
from robosim.playback import entities, palette
from robosim.playback.blueprint import make_beside_blueprint
from robosim.playback.file import recording_file
from robosim.playback.recorder import Recorder
from robosim.playback.scene import send_scene
from robosim.playback.sending import Rooted


@contextlib.contextmanager
def recording_beside(
    path: str | Path, arena: Arena, *, robots: int, scenes: Mapping[str, str], about: Mapping[str, str]
) -> Iterator[dict[str, Recorder]]:
    """Record episodes of `robots` robots in `arena` beside each other to `path`, a .rrd file.

    `scenes` are the runs, a name for people for each root: all of a run lies below its root, as a recording
    of it alone would have it. Gives a recorder for each root. The file appears under its name when the block
    ends without an exception; with one, nothing is left. Raises InputError on entry if it cannot be written.
    """
    name = ", ".join((arena.name, f"{robots} robots", *about.values(), " and ".join(scenes.values())))
    colours = palette.ROBOTS
    with recording_file(Path(path), make_beside_blueprint(arena, robots, scenes), name) as stream:
        recorders: dict[str, Recorder] = {}
        for number, (root, words) in enumerate(scenes.items()):
            place = Rooted(stream, root)
            send_scene(place, arena, robots, rewards=False)
            for plot in (entities.DELIVERED, entities.DENSITY):
                style = rr.SeriesLines(
                    names=words,
                    colors=colours[number % len(colours)],
                    widths=2.0,
                    interpolation_mode="StepAfter",
                    aggregation_policy="Off",
                )
                place.log(plot, style, static=True)
            facts = {
                "arena": f"{arena.name}: {arena.description}",
                "robots": str(robots),
                "world": words,
                **about,
                "rewards": "not worked out: nobody learns here",
            }
            recorders[root] = Recorder(place, arena, robots, Path(path).parent, facts)
        yield recorders
        for recorder in recorders.values():
            recorder.finish()
