"""What robots perceive may be wrong; what they are paid and how they are judged may not."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from robosim.arena import load_arena
from robosim.control.lanes import LanesController
from robosim.discretise.dec_pomdp import DecPomdp
from robosim.discretise.modes import Mode
from robosim.discretise.observation import ObservationLayout
from robosim.discretise.pheromone import PheromoneConfig
from robosim.discretise.reward import RewardConfig
from robosim.discretise.sensing import ExactSensor, Percept
from robosim.envs.vector import VectorEnv
from robosim.world.state import WorldState

LAYOUT = ObservationLayout("expanded", True, "cardinal", 2)


class Copies:
    """Perceives exactly, through copies, so that nothing is computed once for truth and percept."""

    def reset(self, seeds: Sequence[np.random.SeedSequence]) -> None:
        self.seeds = list(seeds)

    def sense(self, state: WorldState) -> Percept:
        return Percept(*(part.copy() for part in ExactSensor().sense(state)))


class Astray(Copies):
    """Feels everything one cell too far east, feels no touch, and feels pellets that are not there."""

    def sense(self, state: WorldState) -> Percept:
        percept = super().sense(state)
        percept.pose[..., 0] += load_arena("paper").cell_size
        return percept._replace(
            touched=np.zeros_like(percept.touched), laden=~percept.laden, pellets=percept.pellets + 0.05
        )


def along_a_run(sensor, decisions: int = 120):
    """Yield an environment and a Dec-POMDP of `sensor` that follows its worlds, after each decision."""
    env = VectorEnv("paper", robots=6, num_envs=2, seed=3, autoreset=False)
    other = DecPomdp(env.world, LAYOUT, RewardConfig(), PheromoneConfig(), sensor)
    lanes, rng = LanesController(), np.random.default_rng(0)
    observation = env.reset()
    seeds = [np.random.SeedSequence(seed) for seed in (8, 9)]
    other.reset(env.world.state, seeds)
    lanes.reset(env)
    for _ in range(decisions):
        actions = np.where(rng.random((2, 6)) < 0.2, rng.integers(0, 5, (2, 6)), lanes.act(env, observation))
        transition = env.step(actions)
        observation = transition.observation
        yield env, other, transition, other.update(actions, env.world.state)


def test_an_exact_percept_gives_the_same_bits_whether_or_not_it_is_the_truth_itself() -> None:
    for env, other, transition, reward in along_a_run(Copies()):
        assert other.observe().tobytes() == transition.observation.tobytes()
        assert reward.astype(np.float32).tobytes() == transition.reward.tobytes()
        assert_array_equal(other.shown_mode, env.dec_pomdp.shown_mode)
        assert other.pheromone.occupancy.tobytes() == env.dec_pomdp.pheromone.occupancy.tobytes()


def test_a_sensor_that_errs_changes_observations_and_pheromones_but_neither_reward_nor_metrics() -> None:
    names = list(LAYOUT.names)
    x, laden = names.index("x"), names.index("laden")
    paid = collided = 0.0
    for env, other, transition, reward in along_a_run(Astray()):
        seen = other.observe()
        assert_array_equal(seen[..., laden], 1.0 - transition.observation[..., laden])
        shift = load_arena("paper").cell_size / load_arena("paper").size[0]
        assert seen[..., x] == pytest.approx(transition.observation[..., x] + shift, abs=1e-6)
        assert_array_equal(reward.astype(np.float32), transition.reward)
        assert_array_equal(other.truth.collided, transition.collided)
        assert_array_equal(other.truth.blocked, transition.blocked)
        assert_array_equal(other.density, env.dec_pomdp.density)
        assert (other.shown_mode != 6).all()
        assert (other.collisions == 0).all()
        paid += float(transition.reward.sum())
        collided += float(transition.collided.sum())
    assert paid > 50.0
    assert collided > 10
    assert (other.pheromone.occupancy != env.dec_pomdp.pheromone.occupancy).any()


def test_sensors_draw_from_seeds_of_their_own() -> None:
    sensor = Copies()
    next(iter(along_a_run(sensor)))
    assert [seed.entropy for seed in sensor.seeds] == [8, 9]


class Unaware(ExactSensor):
    """Perceives all but that a move was refused."""

    def sense(self, state: WorldState) -> Percept:
        return super().sense(state)._replace(refused=np.zeros_like(state.refused))


def test_who_does_not_notice_a_refusal_shows_no_collision_by_it() -> None:
    env = VectorEnv("paper", robots=1, world="grid")
    env.reset()
    other = DecPomdp(env.world, LAYOUT, RewardConfig(), PheromoneConfig(), Unaware())
    other.reset(env.world.state, [np.random.SeedSequence(0)])
    while not env.world.state.refused.any():
        env.step([[0]])
        other.update(np.array([[0]]), env.world.state)
    env.step([[4]])
    other.update(np.array([[4]]), env.world.state)
    assert other.truth.blocked.all()
    assert env.dec_pomdp.shown_mode[0, 0] == Mode.COLLISION
    assert other.shown_mode[0, 0] != Mode.COLLISION
