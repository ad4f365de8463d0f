"""`robosim play LOG.jsonl`: what the log of a controller tells, as a recording."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robosim.deploy.retrace import Retrace
    from robosim.episodes.control_frame import ControlFrame

EVERY = 1000
"""Control periods between two lines that say how far it is."""


def record_log(log: Path, recording: Path, decisions: int | None) -> tuple[str, bool]:
    """Record what the log of a controller tells, up to so many decisions; return what that was, in words.

    And whether it was all: an interrupt keeps what there is. InputError for what is no log.
    """
    from robosim.deploy.retrace import Retrace
    from robosim.playback.control import control_recording
    from robosim.robot.drivers import ACTION_NAMES

    retrace = Retrace(log)
    head, complete = retrace.head, True
    about = {"policy": head.policy, "log": log.name}
    if head.robot is not None:
        about["obeyed by"] = f"robot {head.robot} alone, which drives itself"
    kept = control_recording(
        recording,
        retrace.arena,
        robots=head.env.robots,
        action_names=ACTION_NAMES[head.env.actions],
        about=about,
    )
    periods, last = 0, 0.0
    with kept as recorder:
        try:
            for frame in _up_to(retrace, decisions):
                recorder.add(frame)
                periods, last = periods + 1, frame.time
                if periods % EVERY == 0:
                    print(f"control period {periods}, {last:.0f} s", flush=True)
        except KeyboardInterrupt:
            complete = False
        recorder.tell(_vouched(retrace))
    return f"{periods} control periods, {retrace.decisions} decisions, {last:.0f} s", complete


def _up_to(retrace: Retrace, decisions: int | None) -> Iterator[ControlFrame]:
    for frame in retrace.frames():
        if decisions is not None and frame.step >= decisions:
            return
        yield frame


def _vouched(retrace: Retrace) -> dict[str, str]:
    """Return how far the log vouches for what was worked out again."""
    if retrace.head.map == "shared":
        pheromones = "not shown: the map was kept elsewhere for all robots, and a log does not hold it"
        return {"pheromones": pheromones, "modes of others": "as this robot took them to be"}
    if retrace.first_unlike is None:
        found = f"those of the log in all {retrace.decisions} decisions, to the last bit"
        return {
            "observations": found,
            "pheromones": "worked out again, and so those that the controller held",
        }
    found = (
        f"those of the log in {retrace.vouched} of {retrace.decisions} decisions, the first unlike one is "
        f"{retrace.first_unlike}"
    )
    caution = "worked out again; from that decision on they may not be those that the controller held"
    return {"observations": found, "pheromones": caution}
