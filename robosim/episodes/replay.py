"""Run a recorded trajectory again: the same bodies, to the last bit."""

from __future__ import annotations

from collections.abc import Iterator

from robosim.arena import parse_arena
from robosim.envs.vector import Snapshot, VectorEnv
from robosim.episodes.frame import Frame
from robosim.episodes.trajectory import Trajectory
from robosim.errors import InputError


def replay(trajectory: Trajectory, source: str = "trajectory") -> Iterator[Frame]:
    """Yield the frame at the start of the recorded episode and after each decision.

    The arena is what the trajectory's text says. A frame's arrays are valid until the next one. Raises
    InputError for a text that is no arena, or more robots than fit it; `source` is what it calls the
    trajectory.
    """
    env = begun(trajectory, source)
    yield env.frame()
    for actions in trajectory.chosen:
        env.step(actions[None])
        yield env.frame()


def begun(trajectory: Trajectory, source: str = "trajectory") -> VectorEnv:
    """Return an environment of one arena at the start of the recorded episode."""
    decisions = len(trajectory.chosen)
    if decisions == 0:
        raise InputError(f"{source}: it holds no decisions.")
    # As text alone: a stranger's file must not name a file of this machine.
    arena = parse_arena(trajectory.config.arena, source)
    config = trajectory.config.changed(episode_steps=decisions)
    try:
        env = VectorEnv(config, arena=arena, seed=[trajectory.seed], autoreset=False)
    except InputError as error:
        raise InputError(f"{source}: {error}") from None
    env.restore(Snapshot(env.seeds, trajectory.episode, trajectory.chosen[:0, None]))
    drawn = None if env.drawn is None else env.drawn[0].table()
    if trajectory.drawn is not None and trajectory.drawn != drawn:
        raise InputError(
            f"{source}: drawn is not what its seed, episode and profile draw here, so it cannot be run again."
        )
    return env
