"""The teams without a plan: alone each works, together they jam, give up or rest as their protocol says."""

import numpy as np
import pytest

import robosim
from robosim.arena import load_arena, parse_arena
from robosim.arena.model import Zone
from robosim.control.controller import make_controller
from robosim.control.evaluate import evaluate
from robosim.control.protocols import (
    ActiveController,
    LorenzController,
    ReversalController,
    lorenz_probabilities,
)
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError
from robosim.robot.drivers import STOP
from tests.strategies.arenas import OF_EQUALS

PROTOCOLS = ("active", "reversal", "lorenz")
CLASSES = (ActiveController, ReversalController, LorenzController)


class Watched:
    """A team at work, and what is noted of it after each decision."""

    def __init__(self, controller, arena, robots: int, envs: int, decisions: int, seed: int) -> None:
        self.env = VectorEnv(arena, robots=robots, num_envs=envs, seed=seed, episode_steps=decisions)
        self.env.autoreset = False
        self.collisions = np.zeros(envs, dtype=np.int64)
        self.came_back = np.zeros((envs, robots), dtype=np.int64)
        """[envs, robots] returns to the home from the tunnel with nothing taken on the trip."""
        self.left_home = np.zeros((envs, robots), dtype=np.bool_)
        actions, self.zones = [], []
        seeking = np.zeros((envs, robots), dtype=np.bool_)
        observation = self.env.reset()
        controller.reset(self.env)
        for _ in range(decisions):
            actions.append(controller.act(self.env, observation))
            observation = self.env.step(actions[-1]).observation
            self.collisions += self.env.dec_pomdp.truth.collided.sum(axis=1)
            self.zones.append(zones_of(self.env))
            laden, home = self.env.world.state.held >= 0, self.zones[-1] == Zone.HOME
            self.came_back += seeking & home & ~laden
            seeking = (seeking | (self.zones[-1] == Zone.TUNNEL)) & ~home & ~laden
        self.actions = np.array(actions)

    @property
    def delivered(self) -> np.ndarray:
        return self.env.delivered


def zones_of(env: VectorEnv) -> np.ndarray:
    cells = (env.world.state.pose[..., :2] / env.arena.cell_size).astype(np.int64)
    return env.arena.zones[cells[..., 1], cells[..., 0]]


def gini(values: np.ndarray) -> float:
    ordered, n = np.sort(values), len(values)
    return float((2 * np.arange(1, n + 1) - n - 1) @ ordered / (n * ordered.sum()))


@pytest.fixture(scope="module")
def head_on() -> dict[str, Watched]:
    """Two robots, one at each end of a tunnel one robot wide: they meet on the first trip."""
    poses = "\n[start]\nposes = [[0.4, 0.6, 0.0], [3.0, 0.6, 0.0]]\n"
    arena = parse_arena(load_arena("single-lane").text + poses, "head-on")
    return {
        name: Watched(make_controller(name), arena, 2, envs=4, decisions=600, seed=3)
        for name in ("lanes", "active", "reversal")
    }


@pytest.fixture(scope="module")
def lorenz_team() -> Watched:
    return Watched(LorenzController(), "paper", 8, envs=3, decisions=1000, seed=4)


def test_one_robot_on_paper_brings_as_much_as_one_that_keeps_lanes() -> None:
    """46 in 5000 decisions, that is 9.2 in 1000; without lanes the route is a little shorter."""
    assert 9 <= Watched(ActiveController(), "paper", 1, envs=1, decisions=1000, seed=21).delivered.sum() <= 11


@pytest.mark.parametrize("name", OF_EQUALS)
def test_one_robot_delivers_on_every_arena(name) -> None:
    for kind in CLASSES:
        assert (Watched(kind(), name, 1, envs=1, decisions=300, seed=8).delivered >= 1).all()


def test_long_robots_alone_get_free_where_they_are_wedged_by_walls() -> None:
    """Six capsules, each for itself: without getting free, most would stand still for good."""
    trips = Watched(ActiveController(), "three-wide", 1, envs=6, decisions=700, seed=21).delivered
    assert (trips >= 4).all()


def test_one_robot_always_goes_and_never_gives_up() -> None:
    active, *others = (Watched(kind(), "paper", 1, 1, 350, seed=1).actions.tolist() for kind in CLASSES)
    assert others == [active, active]


def test_active_robots_that_meet_head_on_stand_there_for_good(head_on) -> None:
    lanes, active = head_on["lanes"], head_on["active"]
    assert active.delivered.sum() < 0.5 * lanes.delivered.sum()
    assert (active.delivered.sum(axis=1) == 0).sum() >= 2
    assert active.collisions.sum() > 5 * lanes.collisions.sum()
    assert active.came_back.sum() == 0


def test_robots_of_reversal_turn_back_and_so_dissolve_the_jam(head_on) -> None:
    active, reversal = head_on["active"], head_on["reversal"]
    assert reversal.came_back.sum() >= 3
    assert (reversal.delivered > 0).all()
    assert reversal.delivered.sum() > 2 * active.delivered.sum()


def test_robots_in_a_crowd_are_in_contact_much_more_than_those_that_keep_lanes() -> None:
    lanes, active = (Watched(make_controller(n), "paper", 8, 2, 250, seed=2) for n in ("lanes", "active"))
    assert active.collisions.sum() > 5 * lanes.collisions.sum()


def test_probabilities_of_lorenz_are_as_unequal_as_the_ants_work() -> None:
    assert lorenz_probabilities(1).tolist() == [1.0]
    for robots in (4, 30, 100):
        chances = lorenz_probabilities(robots)
        assert chances.shape == (robots,)
        assert chances[0] == 1.0
        assert (np.diff(chances) < 0).all()
        assert (chances > 0).all()
    assert gini(lorenz_probabilities(30)) == pytest.approx(0.74, abs=0.01)
    assert gini(lorenz_probabilities(1000)) == pytest.approx(0.74, abs=0.001)


def test_work_of_lorenz_is_unequal(lorenz_team) -> None:
    work = lorenz_team.delivered.sum(axis=0)
    assert work[0] == work.max()
    assert work[:2].sum() > 0.6 * work.sum()
    assert gini(work) > 0.55


def test_robots_with_the_smallest_probability_stay_at_home_and_obstruct_nobody(lorenz_team) -> None:
    env, zones = lorenz_team.env, np.array(lorenz_team.zones)
    assert (lorenz_team.delivered[:, -2:] == 0).all()
    assert (zones[20:, :, -2:] == Zone.HOME).all()
    # They stand still, in the half of the home that is farther from the tunnel.
    assert (lorenz_team.actions[-200:, :, -2:] == STOP).mean() > 0.9
    to_source = env.arena.distances.sample(env.world.state.pose[:, -2:, :2])[..., 1]
    rows, columns = np.nonzero(env.arena.zones == Zone.HOME)
    middles = np.stack([columns + 0.5, rows + 0.5], axis=1) * env.arena.cell_size
    assert (to_source > np.median(env.arena.distances.sample(middles)[:, 1])).all()


@pytest.mark.parametrize("arena", ["single-lane", "three-wide"])
@pytest.mark.parametrize("kind", CLASSES)
def test_a_batch_is_driven_as_its_members_alone(kind, arena) -> None:
    together = Watched(kind(), arena, 5, envs=2, decisions=150, seed=2)
    for index, seed in enumerate(together.env.seeds):
        alone = Watched(kind(), arena, 5, envs=1, decisions=150, seed=[seed])
        assert alone.actions[:, 0].tolist() == together.actions[:, index].tolist()
        assert alone.env.world.state.pose[0].tobytes() == together.env.world.state.pose[index].tobytes()


@pytest.mark.parametrize("kind", CLASSES)
def test_equal_seeds_give_equal_actions(kind) -> None:
    first, again = (Watched(kind(seed=7), "single-lane", 5, 2, 150, seed=2).actions for _ in range(2))
    assert first.tolist() == again.tolist()


def test_draws_follow_own_seed_and_episode() -> None:
    first, other = (Watched(LorenzController(seed=s), "paper", 8, 2, 120, seed=2).actions for s in (0, 1))
    assert first.tolist() != other.tolist()
    env = VectorEnv("paper", robots=8, seed=2)
    controller = LorenzController()
    chances = []
    for _ in range(2):
        env.reset()
        controller.reset(env)
        chances.append(controller._draw(np.ones((1, 8), dtype=np.bool_)).tolist())
    assert chances[0] != chances[1]


@pytest.mark.parametrize("name", PROTOCOLS)
def test_they_drive_by_cardinal_actions_only(name) -> None:
    env = VectorEnv("paper", robots=1, actions="wheels")
    env.reset()
    with pytest.raises(InputError) as caught:
        make_controller(name).reset(env)
    assert str(caught.value) == (
        f"{name}: drives by cardinal actions only, and the environment's actions are 'wheels'."
    )


@pytest.mark.parametrize("robots", [1, 35])
@pytest.mark.parametrize("name", PROTOCOLS)
def test_any_team_gets_actions_in_range(name, robots) -> None:
    actions = Watched(make_controller(name), "paper", robots, envs=2, decisions=60, seed=1).actions
    assert actions.shape == (60, 2, robots)
    assert actions.dtype == np.int64
    assert ((actions >= 0) & (actions <= 4)).all()


@pytest.mark.parametrize("name", PROTOCOLS)
def test_robots_of_unlike_speeds_rest_each_for_its_own_round_trip(name) -> None:
    groups = "".join(
        f'\n[[groups]]\nname = "{one}"\n[groups.robot]\nmax_wheel_speed = {speed}\n'
        for one, speed in (("fast", 12.5), ("slow", 6.25))
    )
    env = VectorEnv(load_arena("paper").text + groups, robots=4, episode_steps=40)
    controller = make_controller(name)
    assert len(evaluate(controller, env, 1).totals) == 1
    if name != "active":
        fast, slow = controller._round_trip[:2]
        assert slow in (2 * fast - 1, 2 * fast)


@pytest.mark.parametrize("name", [*PROTOCOLS, "lanes", "random"])
def test_environments_in_other_processes_are_refused_in_a_sentence(name) -> None:
    with robosim.vector_env("paper", robots=2, num_envs=2, workers=2) as env:
        env.reset()
        with pytest.raises(InputError) as caught:
            make_controller(name).reset(env)
    assert str(caught.value) == f"{name}: looks into the world of the environments, so workers must be 1."
