"""One episode of a controller, recorded."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

from robosim.control.controller import Controller
from robosim.envs.vector import VectorEnv
from robosim.playback.recorder import recording


class OnStep(Protocol):
    """Hears of every decision."""

    def __call__(self, step: int, delivered: int) -> None: ...


def record_episode(
    controller: Controller,
    env: VectorEnv,
    path: str | Path,
    *,
    about: Mapping[str, str] | None = None,
    on_step: OnStep | None = None,
) -> int:
    """Run a new episode of the first environment of `env` and record it to `path`; return its decisions.

    An interrupt (Ctrl-C) ends the episode early: what has been recorded is kept, and fewer decisions than
    `env.episode_steps` are returned. Raises InputError before anything runs if `path` cannot be written.
    `env` must have been made with `autoreset=False`, or the last frame would show the next episode.
    """
    if env.autoreset:
        raise ValueError("record_episode needs an environment with autoreset=False")
    with recording(path, env.arena, robots=env.robots, about=about) as recorder:
        observation = env.reset()
        controller.reset(env)
        recorder.add(env.frame())
        try:
            while env.steps_taken < env.episode_steps:
                observation = env.step(controller.act(env, observation)).observation
                recorder.add(env.frame())
                if on_step is not None:
                    on_step(env.steps_taken, int(env.delivered[0].sum()))
        except KeyboardInterrupt:
            pass
    return env.steps_taken
