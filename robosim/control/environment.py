"""The environment that a controller asks for."""

from __future__ import annotations

from pathlib import Path

from robosim.control.controller import Controller
from robosim.control.learned import LearnedController
from robosim.envs.vector import VectorEnv

DEFAULT_ARENA = "paper"
DEFAULT_ROBOTS = 4


def environment_for(
    controller: Controller,
    arena: str | Path | None = None,
    robots: int | None = None,
    *,
    num_envs: int = 1,
    seed: int = 0,
    episode_steps: int | None = None,
    autoreset: bool = True,
) -> VectorEnv:
    """Return an environment whose observations and actions fit `controller`.

    What is left open is what a policy was trained with, or else the arena `paper` and four robots.
    Raises InputError for values out of range.
    """
    card = controller.policy.card if isinstance(controller, LearnedController) else None
    return VectorEnv(
        arena or (card.arena.name if card else DEFAULT_ARENA),
        robots=robots if robots is not None else card.robots if card else DEFAULT_ROBOTS,
        num_envs=num_envs,
        seed=seed,
        actions=card.actions if card else "cardinal",
        encoding=card.observation.encoding if card else "expanded",
        stigmergy=card.observation.stigmergy if card else True,
        pheromone=card.observation.pheromone.config if card else None,
        episode_steps=episode_steps,
        autoreset=autoreset,
    )
