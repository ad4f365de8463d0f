"""Noise is as large as asked for, delays are exact, and what gets lost leaves the last value."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from robosim.arena import Zone, load_arena
from robosim.discretise.noise import (
    Arrivals,
    NoisySensor,
    Reader,
    ReadingConfig,
    SensingConfig,
    make_sensor,
)
from robosim.discretise.sensing import ExactSensor
from robosim.world.factory import make_world
from robosim.world.state import WorldState, blank_state

PAPER = load_arena("paper")
ENVS, ROBOTS = 3, 4
SEEDS = [np.random.SeedSequence(number) for number in range(ENVS)]


def sensor(**options: float) -> NoisySensor:
    made = NoisySensor(SensingConfig(**options), PAPER, ENVS, ROBOTS)
    made.reset(SEEDS)
    return made


def still() -> WorldState:
    """Robots in the middle of the home, away from all walls."""
    state = blank_state(ENVS, ROBOTS, 5)
    state.pose[...] = (*PAPER.start_places.mean(axis=0), 1.0)
    return state


def moving(decision: int) -> WorldState:
    state = still()
    state.pose[..., 0] += 0.001 * decision
    state.pose[..., 2] = 0.01 * decision + np.arange(ROBOTS)
    return state


def test_a_sensor_without_errors_is_the_exact_one() -> None:
    world = make_world("physics", PAPER, ROBOTS, ENVS)
    assert isinstance(make_sensor(SensingConfig(), world), ExactSensor)
    assert isinstance(make_sensor(SensingConfig(delay=1), world), NoisySensor)


def test_errors_are_as_large_as_the_profile_says_and_centred() -> None:
    state, noisy = still(), sensor(position_noise=0.01, heading_noise=0.05)
    errors = np.concatenate([noisy.sense(state).pose - state.pose for _ in range(800)]).reshape(-1, 3)
    assert errors.std(axis=0) == pytest.approx([0.01, 0.01, 0.05], rel=0.03)
    assert np.abs(errors.mean(axis=0)).max() < 0.05 * 0.05
    assert abs(np.corrcoef(errors.T)[0, 1]) < 0.05
    assert len(np.unique(errors[:, 0])) == len(errors)


def test_outliers_are_as_many_and_as_wild_as_the_profile_says() -> None:
    state, noisy = still(), sensor(outliers=0.1, outlier_size=0.05)
    errors = np.stack([noisy.sense(state).pose - state.pose for _ in range(1000)])
    off = (errors[..., :2] != 0.0).any(axis=-1)
    assert off.mean() == pytest.approx(0.1, abs=0.01)
    assert errors[off][:, :2].std() == pytest.approx(0.05, rel=0.07)
    assert (errors[..., 2] == 0.0).all()


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_fix_arrives_after_exactly_so_many_decisions(delay: int) -> None:
    late = sensor(delay=delay)
    for decision in range(12):
        seen = late.sense(moving(decision)).pose
        assert_array_equal(seen, moving(max(0, decision - delay)).pose)


def test_between_two_fixes_the_last_one_holds() -> None:
    slow = sensor(update_every=4)
    for decision in range(13):
        seen = slow.sense(moving(decision)).pose
        assert_array_equal(seen, moving(decision - decision % 4).pose)


def test_a_lost_fix_leaves_the_last_one_for_that_robot_alone() -> None:
    lossy = sensor(dropout=0.3)
    last = lossy.sense(moving(0)).pose.copy()
    assert_array_equal(last, moving(0).pose)
    lost = []
    for decision in range(1, 1000):
        seen, now = lossy.sense(moving(decision)).pose, moving(decision).pose
        fresh = (seen == now).all(axis=-1)
        assert ((seen == last).all(axis=-1) | fresh).all()
        lost.append(~fresh)
        last = seen.copy()
    assert np.mean(lost) == pytest.approx(0.3, abs=0.015)
    assert len({share.tobytes() for share in lost}) > 100


@pytest.mark.parametrize("options", [{"delay": 2, "dropout": 0.3}, {"update_every": 3, "dropout": 0.2}])
def test_the_age_is_that_of_the_fix_that_is_believed(options) -> None:
    """Robots that move tell by their heading when a pose was measured."""
    noisy = sensor(**options)
    assert_array_equal(ExactSensor().age, 0)
    ages = []
    for decision in range(30):
        believed = noisy.sense(moving(decision)).pose
        made = np.rint((believed[..., 2] - np.arange(ROBOTS)) / 0.01)
        assert_array_equal(noisy.age, decision - made)
        ages.append(noisy.age)
    assert np.max(ages) > 3
    noisy.reset(SEEDS)
    noisy.sense(moving(0))
    assert_array_equal(noisy.age, 0)


def test_what_a_robot_feels_on_its_own_body_stays_exact() -> None:
    state = still()
    state.held[0, 1] = 2
    exact, seen = ExactSensor().sense(state), sensor(position_noise=0.1, delay=2, dropout=0.5).sense(state)
    for name in exact._fields:
        if name != "pose":
            assert_array_equal(getattr(seen, name), getattr(exact, name))


def test_nobody_takes_itself_for_standing_in_a_wall_however_far_off() -> None:
    state, noisy = still(), sensor(position_noise=5.0)
    inside = 0
    for _ in range(100):
        position = noisy.sense(state).pose[..., :2]
        cells = (position / PAPER.cell_size).astype(int)
        assert (PAPER.zones[cells[..., 1], cells[..., 0]] != Zone.WALL).all()
        inside += int((np.abs(position - state.pose[..., :2]) > 0.5).sum())
    assert inside > 100


def test_each_environment_errs_as_it_would_alone() -> None:
    together = sensor(position_noise=0.02, heading_noise=0.1, dropout=0.2, delay=1)
    alone = NoisySensor(together._config, PAPER, 1, ROBOTS)
    alone.reset(SEEDS[1:2])
    for decision in range(150):
        state = moving(decision)
        one = moving(decision)
        one.pose = one.pose[1:2]
        one.held = one.held[1:2]
        assert together.sense(state).pose[1].tobytes() == alone.sense(one).pose[0].tobytes()


def test_arrivals_against_a_list_of_all_that_was_sent() -> None:
    rng, delay = np.random.default_rng(0), 2
    arrivals = Arrivals(delay)
    sent, kept = rng.random((30, 2, 3, 5)), rng.random((30, 2, 3)) < 0.5
    for now in range(30):
        found = arrivals.take(sent[now], kept[now])
        for env, robot in np.ndindex(2, 3):
            arrived = [one for one in range(now - delay + 1) if kept[one, env, robot]]
            last = arrived[-1] if arrived else 0
            assert_array_equal(found[env, robot], sent[last, env, robot])


def reader(**options: float) -> Reader:
    made = Reader(ReadingConfig(**options))
    made.reset(SEEDS)
    return made


def patch(value: float) -> np.ndarray:
    return np.full((ENVS, ROBOTS, 20), value, dtype=np.float32)


def test_readings_err_as_much_as_the_profile_says() -> None:
    by_factor, besides = reader(gain_noise=0.1), reader(additive_noise=0.05)
    scaled = np.stack([by_factor.read(patch(0.5)) for _ in range(100)])
    assert scaled.std() == pytest.approx(0.05, rel=0.03)
    assert scaled.mean() == pytest.approx(0.5, abs=0.002)
    assert (by_factor.read(patch(0.0)) == 0.0).all()
    shifted = np.stack([besides.read(patch(0.5)) for _ in range(100)])
    assert shifted.std() == pytest.approx(0.05, rel=0.03)
    low = besides.read(patch(0.0))
    assert low.min() == 0.0
    assert (low == 0.0).mean() == pytest.approx(0.5, abs=0.1)


def test_coarse_readings_have_so_many_values() -> None:
    values = np.linspace(0.0, 1.0, ENVS * ROBOTS * 20, dtype=np.float32).reshape(ENVS, ROBOTS, 20)
    seen = reader(levels=5).read(values)
    assert np.unique(seen).tolist() == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert np.abs(seen - values).max() <= 0.125 + 1e-6


def test_readings_come_late_and_get_lost() -> None:
    late = reader(delay=2)
    assert [float(late.read(patch(0.1 * now))[0, 0, 0]) for now in range(5)] == pytest.approx(
        [0.0, 0.0, 0.0, 0.1, 0.2]
    )
    lossy, last, lost = reader(loss=0.25), patch(0.0), []
    lossy.read(last)
    for now in range(1, 600):
        seen = lossy.read(patch(now / 600))
        fresh = (seen == patch(now / 600)).all(axis=-1)
        assert (fresh | (seen == last).all(axis=-1)).all()
        lost.append(~fresh)
        last = seen
    assert np.mean(lost) == pytest.approx(0.25, abs=0.02)
