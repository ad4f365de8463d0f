"""Real trajectories, recorded once for all tests: the lane keeper mixed with random actions."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from robosim.arena import Arena, load_arena, parse_arena
from robosim.control.controller import make_controller
from robosim.discretise.observation import ObservationLayout
from robosim.discretise.pheromone import PheromoneConfig
from robosim.envs.vector import VectorEnv

TINY = '''
name = "tiny"
cell_size = 0.15
map = """
########
#HH..SS#
#HH..SS#
########
"""
[pellets]
count = 6
[robot]
grip_force = 0.3
'''


@dataclass
class Moment:
    """What a decision led to; arrays [envs, robots, ...] or [envs, pellets]."""

    actions: Any
    pose: Any
    held: Any
    nearest: Any
    pellets: Any
    pellet_status: Any
    touching: Any
    deliveries: Any
    fresh: Any
    lost: Any
    touched: Any
    """[3, envs, robots] another robot, a wall, a pellet."""
    observation: Any
    reward: Any
    mode: Any
    """Collision overlaid."""
    bare_mode: Any
    blocked: Any
    collided: Any
    collisions: Any
    density: Any
    pheromone: Any
    """[envs, rows, columns]."""


@dataclass
class Run:
    """One recorded episode of a batch."""

    arena: Arena
    layout: ObservationLayout
    pheromone: PheromoneConfig
    robots: int
    num_envs: int
    reward: str
    sharing: str
    signed_distance: bool
    idle_cost: bool
    start: Moment
    moments: list[Moment] = field(default_factory=list)


def weak_grip(name: str) -> Arena:
    """A shipped arena whose robots lose their pellets easily."""
    return parse_arena(load_arena(name).text + "\n[robot]\ngrip_force = 0.3\n", "weak-grip.toml")


def _moment(env: VectorEnv, actions: Any, observation: Any, reward: Any) -> Moment:
    state, dec = env.world.state, env.dec_pomdp
    frames = [env.frame(index) for index in range(env.num_envs)]
    return Moment(
        actions=actions,
        pose=state.pose.copy(),
        held=state.held.copy(),
        nearest=state.nearest.copy(),
        pellets=state.pellets.copy(),
        pellet_status=state.pellet_status.copy(),
        touching=state.touching.copy(),
        deliveries=state.deliveries.copy(),
        fresh=state.fresh.copy(),
        lost=state.lost.copy(),
        touched=state.touched.copy(),
        observation=observation,
        reward=reward,
        mode=np.stack([frame.mode for frame in frames]),
        bare_mode=dec.mode.copy(),
        blocked=dec.truth.blocked.copy(),
        collided=dec.truth.collided.copy(),
        collisions=dec.collisions.copy(),
        density=np.array([frame.density for frame in frames]),
        pheromone=np.stack([frame.pheromone for frame in frames]),
    )


def _record(env: VectorEnv, steps: int, carelessness: float, **described: Any) -> Run:
    rng = np.random.default_rng(7)
    observation = env.reset(3)
    nobody = np.full((env.num_envs, env.robots), 4)
    controller = make_controller("lanes" if env.layout.actions == "cardinal" else "random")
    controller.reset(env)
    run = Run(
        arena=env.arena,
        layout=env.layout,
        robots=env.robots,
        num_envs=env.num_envs,
        start=_moment(env, nobody, observation, np.zeros(nobody.shape)),
        **described,
    )
    for _ in range(steps):
        actions = controller.act(env, observation)
        careless = rng.random(actions.shape) < carelessness
        actions = np.where(careless, rng.integers(0, 5, actions.shape), actions)
        transition = env.step(actions)
        observation = transition.observation
        run.moments.append(_moment(env, actions, observation, transition.reward))
    return run


RUNS: dict[str, tuple[Any, int, float, dict[str, Any]]] = {
    "paper": (lambda: load_arena("paper"), 350, 0.1, {"robots": 4, "num_envs": 2}),
    "single-lane": (
        lambda: load_arena("single-lane"), 200, 0.1,
        {"robots": 6, "num_envs": 2, "encoding": "paper", "reward": "local",
         "pheromone": PheromoneConfig(decay=0.05, reinforcement=0.2, initial=0.3, diffusion=0.1, radius=1)},
    ),
    "weak grip": (lambda: weak_grip("paper"), 250, 0.15, {"robots": 6, "reward": "local"}),
    "three-wide": (lambda: load_arena("three-wide"), 150, 0.2, {"robots": 8, "sharing": "split"}),
    "two-tunnels": (
        lambda: load_arena("two-tunnels"), 150, 0.1,
        {"robots": 3, "num_envs": 2, "encoding": "paper", "stigmergy": False},
    ),
    "tiny": (
        lambda: parse_arena(TINY, "tiny.toml"), 200, 0.3,
        {"robots": 3, "num_envs": 3, "pheromone": PheromoneConfig(radius=6, diffusion=0.0)},
    ),
    "signed": (
        lambda: parse_arena(TINY, "tiny.toml"), 150, 0.3,
        {"robots": 3, "reward": "local", "signed_distance": True, "idle_cost": True},
    ),
    "wheels": (lambda: parse_arena(TINY, "tiny.toml"), 150, 0.0, {"robots": 3, "actions": "wheels"}),
    "nine": (
        lambda: load_arena("paper"), 150, 0.0,
        {"robots": 12, "actions": "wheels-9", "pheromone": PheromoneConfig(radius=1)},
    ),
    "full home": (lambda: load_arena("paper"), 25, 0.2, {"robots": 35, "stigmergy": False}),
}  # fmt: skip


@cache
def recorded(name: str) -> Run:
    """The run of that name."""
    arena, steps, carelessness, options = RUNS[name]
    env = VectorEnv(arena(), episode_steps=10_000, **options)
    described = {
        "pheromone": options.get("pheromone", PheromoneConfig()),
        "reward": options.get("reward", "global"),
        "sharing": options.get("sharing", "copied"),
        "signed_distance": options.get("signed_distance", False),
        "idle_cost": options.get("idle_cost", False),
    }
    return _record(env, steps, carelessness, **described)
