"""The options that every face of the environment takes and hands to the batched one."""

from __future__ import annotations

from typing import TypedDict

from robosim.discretise.observation import Encoding
from robosim.discretise.pheromone import PheromoneConfig
from robosim.discretise.reward import RewardKind, Sharing
from robosim.robot.drivers import ActionKind


class EnvOptions(TypedDict, total=False):
    """Options of `robosim.envs.vector.VectorEnv`, with its defaults where one is left out."""

    actions: ActionKind
    """`cardinal`: toward the neighbouring cell; `wheels`: wheel speeds."""
    encoding: Encoding
    """`paper`: the paper's eight numbers; `expanded`: one-hot mode, sine and cosine, neighbours."""
    stigmergy: bool
    """Whether the pheromone patch is part of the observation."""
    reward: RewardKind
    """Whether pickups and deliveries pay their robot alone (`local`) or everyone (`global`)."""
    sharing: Sharing
    """Whether a global reward pays everyone the whole (`copied`) or an equal part (`split`)."""
    signed_progress: bool
    """Whether losing ground costs what gaining it pays; the paper pays for gains alone."""
    idle_cost: bool
    """Whether a decision without making way costs what one at top speed pays."""
    pellet_gradient: float
    """How unevenly pellets may lie as an episode begins, from 0, evenly, to 50."""
    episode_steps: int | None
    """Decisions in an episode; None: the arena's."""
    pheromone: PheromoneConfig | None
    """Rates and field of view of the pheromones; None: the defaults."""
