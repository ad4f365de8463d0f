"""Along real trajectories, everything the Dec-POMDP says is what the slow, plain reference says."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from robosim.discretise.modes import Mode
from tests.discretise.plain import PlainDecPomdp
from tests.discretise.recorded import RUNS, recorded


@pytest.mark.parametrize("name", RUNS)
def test_a_run_is_what_the_plain_reference_says(name: str) -> None:
    run = recorded(name)
    names = run.layout.names
    for env in range(run.num_envs):
        plain = PlainDecPomdp(run, env)
        for step, moment in enumerate([run.start, *run.moments]):
            expected_reward = plain.update(moment) if step else [0.0] * run.robots
            where = f"{name}, env {env}, decision {step}"
            robots = plain.robots
            assert moment.mode[env].tolist() == [robot.shown for robot in robots], where
            assert moment.bare_mode[env].tolist() == [robot.mode for robot in robots], where
            assert moment.blocked[env].tolist() == [robot.blocked for robot in robots], where
            assert moment.collided[env].tolist() == [robot.collided for robot in robots], where
            assert moment.collisions[env].tolist() == [robot.collisions for robot in robots], where
            assert moment.density[env] == pytest.approx(plain.density, rel=1e-14), where
            assert_allclose(moment.reward[env], expected_reward, rtol=1e-6, err_msg=where)
            grid = np.zeros(run.arena.zones.shape)
            for (column, row), value in plain.map.occupancy.items():
                grid[row, column] = value
            assert_allclose(moment.pheromone[env], grid, rtol=1e-11, atol=1e-300, err_msg=where)
            for index, robot in enumerate(robots):
                seen = plain.observation(robot)
                assert seen.keys() == set(names)
                assert_allclose(
                    moment.observation[env, index],
                    [seen[one] for one in names],
                    rtol=1e-6, atol=1e-6, err_msg=f"{where}, robot {index}",
                )  # fmt: skip


def test_between_them_the_runs_hold_everything_that_can_happen() -> None:
    runs = [recorded(name) for name in RUNS]
    moments = [(run, moment) for run in runs for moment in run.moments]
    assert {int(mode) for _, moment in moments for mode in moment.mode.flat} == set(map(int, Mode))
    assert sum(moment.deliveries.sum() for _, moment in moments) > 20
    assert sum(moment.lost.sum() for _, moment in moments) > 20
    assert sum(moment.fresh.sum() for _, moment in moments) > 20
    assert sum(moment.collided.sum() for _, moment in moments) > 100
    # Every mode is interrupted by Collision somewhere, on the way and at work.
    interrupted = {int(mode) for _, moment in moments for mode in moment.bare_mode[moment.blocked]}
    assert {Mode.GOING_TO_DIG, Mode.GOING_HOME} <= interrupted
    taken_in_the_tunnel = 0
    for run in runs:
        before = run.start
        for moment in run.moments:
            taken = (before.held < 0) & (moment.held >= 0)
            taken_in_the_tunnel += int((taken & (moment.bare_mode == Mode.GOING_HOME)).sum())
            before = moment
    assert taken_in_the_tunnel > 5
