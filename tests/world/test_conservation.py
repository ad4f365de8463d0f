"""Whatever robots do, no pellet is lost or made, and nothing leaves the arena or enters its walls."""

import numpy as np
import pytest

from robosim.arena import Arena, arena_names
from robosim.control.lanes import LanesController
from robosim.envs.vector import VectorEnv
from robosim.robot.sheet import RobotSheet
from robosim.world.state import PelletStatus

DEEPEST_ROBOT = 2e-3
"""Overlap with a wall that the solver may leave for a moment, m: what a robot drives in a substep or so."""
DEEPEST_PELLET = 0.25
"""The same of a pellet that robots press into a wall, in its radii; for one that weighs a fiftieth of them,
1.6 times that: the solver's ten iterations then leave more."""


def wall_overlap(arena: Arena, points: np.ndarray, radius: float) -> float:
    """Return how deep discs around points [..., 2] reach into walls, m; negative is a gap."""
    low, high = arena.walls[:, :2], arena.walls[:, 2:]
    outside = np.maximum(np.maximum(low - points[..., None, :], points[..., None, :] - high), 0.0)
    return radius - float(np.hypot(outside[..., 0], outside[..., 1]).min())


def robot_discs(sheet: RobotSheet, pose: np.ndarray) -> tuple[np.ndarray, float]:
    """Return discs that fill a robot's outline: centres [..., n, 2] and their radius."""
    assert sheet.shape in {"circle", "capsule"}
    along = np.linspace(-0.5, 0.5, 9) * (sheet.length - sheet.width)
    nose = np.stack([np.cos(pose[..., 2]), np.sin(pose[..., 2])], axis=-1)
    return pose[..., None, :2] + along[:, None] * nose[..., None, :], 0.5 * sheet.width


class Watch:
    """Looks at every decision of a batch, and remembers the worst and how much happened."""

    def __init__(self, env: VectorEnv) -> None:
        self.env = env
        self.robots = self.pellets = -np.inf
        self.lost = self.picked = self.delivered = 0

    def look(self) -> None:
        env, state, arena = self.env, self.env.world.state, self.env.arena
        count = arena.pellets.count
        loose, held, absent = ((state.pellet_status == status).sum(axis=1) for status in PelletStatus)
        assert (loose + held + absent == count).all()
        assert (state.delivered == state.refilled + absent).all()
        assert (held == (state.held >= 0).sum(axis=1)).all()
        for env_index in range(env.num_envs):
            carried = state.held[env_index][state.held[env_index] >= 0]
            assert len(set(carried.tolist())) == len(carried)
            assert (state.pellet_status[env_index, carried] == PelletStatus.HELD).all()
        assert (state.touching[state.held >= 0] == -1).all()
        for values in (state.pose, state.velocity, state.pellets):
            assert np.isfinite(values).all()
        present = state.pellets[state.pellet_status != PelletStatus.ABSENT]
        width, height = arena.size
        for places in (state.pose[..., :2].reshape(-1, 2), present):
            assert (places > 0.0).all()
            assert (places < (width, height)).all()
        for robot in range(self.env.robots):
            sheet = arena.team(self.env.robots).sheets[robot]
            discs = robot_discs(sheet, state.pose[:, robot])
            self.robots = max(self.robots, wall_overlap(arena, *discs))
        self.pellets = max(self.pellets, wall_overlap(arena, present, arena.pellets.radius))
        self.lost += int(state.lost.sum())
        self.picked += int((state.picked >= 0).sum())
        self.delivered += int(state.deliveries.sum())

    def report(self, decisions: int) -> None:
        print(
            f"{self.env.arena.name}: {decisions} decisions of {self.env.robots} robots; "
            f"{self.picked} pellets taken, {self.lost} torn loose, {self.delivered} delivered; "
            f"deepest overlap with a wall: robots {1000 * self.robots:.3f} mm, "
            f"pellets {1000 * self.pellets:.3f} mm"
        )
        sheets = self.env.arena.robot, self.env.arena.pellets
        light = sheets[1].mass < 0.03 * sheets[0].mass
        assert self.robots < DEEPEST_ROBOT
        assert self.pellets < (1.6 if light else 1.0) * DEEPEST_PELLET * sheets[1].radius


def run(env: VectorEnv, decisions: int, share_random: float, seed: int) -> Watch:
    """Drive by lanes, and in a share of the decisions by chance."""
    rng = np.random.default_rng(seed)
    controller, watch = LanesController(), Watch(env)
    observation = env.reset()
    if share_random < 1.0:
        controller.reset(env)
    watch.look()
    for _ in range(decisions):
        chance = rng.integers(0, env.num_actions, (env.num_envs, env.robots))
        if share_random < 1.0:
            dice = rng.random(chance.shape) < share_random
            chance = np.where(dice, chance, controller.act(env, observation))
        observation = env.step(chance).observation
        watch.look()
    watch.report(decisions * env.num_envs)
    return watch


@pytest.mark.slow
def test_twenty_thousand_random_decisions_of_eight_robots() -> None:
    env = VectorEnv("paper", robots=8, num_envs=16, seed=1, episode_steps=10**6)
    run(env, 1250, 1.0, seed=1)


@pytest.mark.slow
def test_twenty_thousand_decisions_in_which_pellets_travel() -> None:
    """Lanes with a fifth of random actions: pellets are torn loose, lie about, and are delivered."""
    env = VectorEnv("paper", robots=8, num_envs=16, seed=2, episode_steps=10**6)
    watch = run(env, 1250, 0.2, seed=2)
    assert watch.lost > 20
    assert watch.picked > 500
    assert watch.delivered > 500


@pytest.mark.parametrize("name", arena_names())
def test_the_same_on_every_arena_that_ships(name) -> None:
    env = VectorEnv(name, robots=8, num_envs=4, seed=3, episode_steps=10**6)
    watch = run(env, 500, 0.2, seed=3)
    assert watch.picked > 10


@pytest.mark.parametrize("name", ["paper", "three-wide"])
def test_the_same_by_wheel_speeds(name) -> None:
    env = VectorEnv(name, robots=8, num_envs=4, seed=4, actions="wheels", episode_steps=10**6)
    run(env, 250, 1.0, seed=4)


def test_the_same_with_everything_random_between_episodes() -> None:
    """Masses, tractions, speeds and frictions differ from robot to robot and from pellet to pellet."""
    from robosim.arena import load_arena, parse_arena

    ranges = "\n".join(
        f"{name} = [0.5, 2.0]" for name in ("robot_mass", "traction", "pellet_mass", "pellet_friction")
    )
    text = load_arena("paper").text + f"\n[randomisation]\n{ranges}\nwheel_speed = [0.6, 1.0]\n"
    env = VectorEnv(parse_arena(text, "varied"), robots=8, num_envs=4, seed=5, episode_steps=100)
    watch = run(env, 300, 0.2, seed=5)
    assert watch.picked > 0
