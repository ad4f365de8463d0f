"""The environment that a controller asks for."""

from __future__ import annotations

from pathlib import Path

from robosim.arena.model import Arena
from robosim.control.controller import Controller
from robosim.control.learned import LearnedController
from robosim.envs.config import EnvConfig
from robosim.envs.profile import ProfileConfig
from robosim.envs.vector import VectorEnv
from robosim.world.factory import WorldKind


def environment_for(
    controller: Controller,
    arena: Arena | str | Path | None = None,
    robots: int | None = None,
    world: WorldKind | None = None,
    *,
    num_envs: int = 1,
    seed: int = 0,
    episode_steps: int | None = None,
    autoreset: bool = True,
    profile: ProfileConfig | str | Path | None = None,
    odometry: float | None = None,
) -> VectorEnv:
    """Return an environment whose observations and actions fit `controller`.

    What is left open is what a policy was trained with, or else what `EnvConfig` says. Pellets lie evenly,
    episodes are as long as the arena says, and nothing is random or wrong about robots without a `profile`,
    however the policy learned. `odometry` takes the place of what the profile says of it (`SensingConfig`).
    Raises InputError for values out of range.
    """
    config = controller.policy.card.env if isinstance(controller, LearnedController) else EnvConfig()
    config = config.changed(profile=None)
    return VectorEnv(
        config,
        arena=config.arena if arena is None else arena,
        robots=robots,
        world=world,
        pellet_gradient=0.0,
        episode_steps=0 if episode_steps is None else episode_steps,
        num_envs=num_envs,
        seed=seed,
        autoreset=autoreset,
        profile=profile,
        sensing_odometry=odometry,
    )
