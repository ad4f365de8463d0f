"""What scripted robots see of each other and of pellets where they stand on cells."""

import numpy as np

from robosim.control.seek import cells_of, moves_blocked_by_robots, toward_pellets
from robosim.envs.vector import VectorEnv
from robosim.robot.drivers import CARDINAL_STEPS
from robosim.world.state import PelletStatus


def mixed(robots: int) -> VectorEnv:
    """An environment of the grid in which robots and pellets have got about."""
    env = VectorEnv("paper", robots=robots, num_envs=3, world="grid", seed=2)
    env.reset()
    rng = np.random.default_rng(0)
    for _ in range(200):
        env.step(rng.choice(5, (3, robots), p=[0.2, 0.2, 0.1, 0.4, 0.1]))
    return env


def test_on_cells_the_neighbouring_cells_with_robots_are_blocked() -> None:
    env = mixed(20)
    blocked = moves_blocked_by_robots(env)
    cells = cells_of(env).tolist()
    for one in range(3):
        for robot, (column, row) in enumerate(cells[one]):
            for action, (x, y) in enumerate(CARDINAL_STEPS[:4].tolist()):
                assert blocked[one, robot, action] == ([column + x, row + y] in cells[one])
    assert blocked.any()


def test_on_cells_a_robot_heads_for_the_nearest_cell_in_which_pellets_lie() -> None:
    env = mixed(5)
    state, cell = env.world.state, cells_of(env)
    seekers = np.ones((3, 5), dtype=np.bool_)
    cost = np.ones((3, 5, 4))
    cost[:, :, 2] = np.inf
    found = toward_pellets(env, seekers, cell, cost)
    assert np.isinf(found[:, :, 2]).all()
    for one in range(3):
        loose = state.pellets[one, state.pellet_status[one] == PelletStatus.LOOSE]
        lies = np.floor(loose / env.arena.cell_size).astype(int) + 1
        for robot in range(5):
            away = [int(np.abs(lies - cell[one, robot] - CARDINAL_STEPS[action]).sum(axis=1).min())
                    for action in (0, 1, 3)]  # fmt: skip
            assert away[found[one, robot, [0, 1, 3]].argmin()] == min(away)


def test_robots_that_seek_nothing_keep_their_costs() -> None:
    env = mixed(5)
    cost = np.arange(60.0).reshape(3, 5, 4)
    assert (toward_pellets(env, np.zeros((3, 5), dtype=np.bool_), cells_of(env), cost) == cost).all()
