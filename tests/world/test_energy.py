"""Energy lost at the wheels is the work that friction under them does, no more and no less."""

import math

import numpy as np
import pytest

from robosim.envs.vector import VectorEnv

FORWARD, SPIN_LEFT, STOP = 0, 2, 4
TOP = 12.5


def test_starting_and_stopping_each_lose_the_kinetic_energy(bench) -> None:
    """A body brought to speed by slipping friction leaves as much heat as it takes; braking leaves it all."""
    b = bench([(1.0, 1.1, 0.0)])
    b.world.meter()
    sheet = b.arena.robot
    kinetic = 0.5 * sheet.mass * sheet.top_speed**2
    b.drive(TOP, TOP, 3)
    started = float(b.world.wheel_energy[0, 0])
    assert started == pytest.approx(kinetic, rel=0.05)
    b.drive(TOP, TOP, 20)
    assert float(b.world.wheel_energy[0, 0]) == pytest.approx(started, rel=1e-6)
    b.drive(0.0, 0.0, 3)
    both = float(b.world.wheel_energy[0, 0])
    print(f"start {started:.5f} J, start and stop {both:.5f} J, kinetic energy {kinetic:.5f} J")
    assert both == pytest.approx(2.0 * kinetic, rel=0.05)


def test_a_robot_held_by_a_wall_loses_traction_times_way(bench) -> None:
    b = bench([(4.1, 1.1, 0.0)])
    b.world.meter()
    b.drive(TOP, TOP, 20)
    before = float(b.world.wheel_energy[0, 0])
    b.drive(TOP, TOP, 10)
    sheet = b.arena.robot
    lost = float(b.world.wheel_energy[0, 0]) - before
    assert lost == pytest.approx(sheet.traction_force * sheet.top_speed * 1.0, rel=1e-3)


def test_standing_still_loses_nothing_and_without_metering_it_is_zero(bench) -> None:
    b = bench([(1.0, 1.1, 0.0)])
    b.drive(TOP, TOP, 3)
    assert float(b.world.wheel_energy[0, 0]) == 0.0
    still = bench([(1.0, 1.1, 0.0)])
    still.world.meter()
    still.drive(0.0, 0.0, 5)
    assert float(still.world.wheel_energy[0, 0]) == 0.0


def test_crossing_the_angle_where_headings_fold_loses_nothing(bench) -> None:
    b = bench([(2.0, 1.1, math.pi - 0.05)])
    b.world.meter()
    b.decide([SPIN_LEFT], times=1)
    turning = float(b.world.wheel_energy[0, 0])
    b.decide([SPIN_LEFT], times=20)
    assert float(b.world.wheel_energy[0, 0]) == pytest.approx(turning, rel=1e-6)


def test_metering_changes_no_bit_and_a_batch_is_as_its_members() -> None:
    actions = np.random.default_rng(0).integers(0, 5, (150, 2, 4))
    plain, metered = (VectorEnv("paper", robots=4, num_envs=2, seed=[3, 9]) for _ in range(2))
    metered.world.meter()
    alone = VectorEnv("paper", robots=4, seed=[9])
    alone.world.meter()
    for env in (plain, metered, alone):
        env.reset()
    for chosen in actions:
        plain.step(chosen)
        metered.step(chosen)
        alone.step(chosen[1:])
        assert plain.world.state.pose.tobytes() == metered.world.state.pose.tobytes()
    assert (metered.world.wheel_energy > 0.0).all()
    assert metered.world.wheel_energy[1].tobytes() == alone.world.wheel_energy[0].tobytes()
    assert metered.frame(1).energy.tolist() == metered.world.wheel_energy[1].tolist()
    metered.reset()
    assert not metered.world.wheel_energy.any()
