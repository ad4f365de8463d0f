"""The grid behind the same face as the physical world: batches, snapshots, policies, scripted robots."""

from __future__ import annotations

import hashlib
import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from robosim.analysis.measure.metrics import NotDefined, summarise
from robosim.analysis.measure.monitor import TeamMonitor
from robosim.control.controller import make_controller
from robosim.control.environment import environment_for
from robosim.control.evaluate import evaluate
from robosim.control.policy import load_policy, policy_names
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError
from robosim.world.state import PelletStatus
from tests.strategies.arenas import OF_EQUALS
from tests.world.grid.rooms import EAST, WEST, room


def played(env: VectorEnv, actions: np.ndarray) -> dict[str, np.ndarray]:
    """Step through actions [steps, envs, robots]; what came of them, environments first."""
    seen: dict[str, list[np.ndarray]] = {}
    for chosen in actions:
        transition, state = env.step(chosen), env.world.state
        for name, value in (
            ("observation", transition.observation), ("reward", transition.reward),
            ("final", transition.final_observation), ("pose", state.pose), ("pellets", state.pellets),
            ("held", state.held), ("refused", state.refused), ("touched", state.touched.swapaxes(0, 1)),
            ("pheromone", env.dec_pomdp.pheromone.occupancy),
        ):  # fmt: skip
            seen.setdefault(name, []).append(value.copy())
    return {name: np.stack(values, axis=1) for name, values in seen.items()}


def same(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> None:
    for name, value in one.items():
        assert value.tobytes() == other[name].tobytes(), name


def traffic(arena: str, robots: int, envs: int, steps: int, seed: int = 5) -> np.ndarray:
    """Lanes with a fifth of random actions, so that robots meet and pellets travel."""
    env = VectorEnv(arena, robots=robots, num_envs=envs, seed=seed, episode_steps=steps, world="grid")
    observation, lanes, rng = env.reset(), make_controller("lanes"), np.random.default_rng(0)
    lanes.reset(env)
    actions = np.empty((steps, envs, robots), dtype=np.int64)
    for step in range(steps):
        chance = rng.integers(0, 5, (envs, robots))
        actions[step] = np.where(rng.random((envs, robots)) < 0.2, chance, lanes.act(env, observation))
        observation = env.step(actions[step]).observation
    return actions


@pytest.mark.parametrize(
    ("arena", "options"),
    [("paper", {}), ("three-wide", {"actions": "wheels"}), ("single-lane", {"pellet_gradient": 3.0})],
)
def test_a_batch_gives_what_its_environments_give_alone(arena: str, options: dict) -> None:
    """To the last bit, and across the ends of episodes; actions of one kind are as good as of the other."""
    actions = traffic(arena, 6, 3, 200)
    batch = VectorEnv(arena, robots=6, num_envs=3, seed=5, episode_steps=90, world="grid", **options)
    batch.reset()
    together = played(batch, actions)
    assert together["refused"].any()
    for env in range(3):
        alone = VectorEnv(arena, robots=6, seed=[batch.seeds[env]], episode_steps=90, world="grid", **options)
        alone.reset()
        same(
            {name: value[env : env + 1] for name, value in together.items()},
            played(alone, actions[:, env : env + 1]),
        )


def test_a_snapshot_brings_back_the_moment_to_the_last_bit() -> None:
    actions = traffic("paper", 8, 2, 180)
    env = VectorEnv("paper", robots=8, num_envs=2, seed=5, episode_steps=100, world="grid")
    env.reset()
    at = played(env, actions[:130])["observation"][:, -1]
    moment = env.snapshot()
    once = played(env, actions[130:])
    other = VectorEnv("paper", robots=8, num_envs=2, seed=0, episode_steps=100, world="grid")
    for one in (env, other):
        assert_array_equal(one.restore(moment), at)
        same(once, played(one, actions[130:]))


SCRIPT = """
import hashlib, numpy as np
from robosim.control.controller import make_controller
from robosim.envs.vector import VectorEnv
env = VectorEnv("paper", robots=8, num_envs=3, seed=7, world="grid")
observation, team = env.reset(), make_controller("active")
team.reset(env)
digest = hashlib.sha256()
for _ in range(400):
    observation = env.step(team.act(env, observation)).observation
    for array in (observation, env.world.state.pose, env.world.state.pellets, env.world.contacts.position):
        digest.update(np.ascontiguousarray(array).tobytes())
print(digest.hexdigest(), int(env.delivered.sum()))
"""


def test_two_processes_agree_to_the_last_bit() -> None:
    printed = [
        subprocess.run([sys.executable, "-c", SCRIPT], check=True, capture_output=True, text=True).stdout
        for _ in range(2)
    ]
    assert printed[0] == printed[1]
    assert len(printed[0].split()[0]) == hashlib.sha256().digest_size * 2
    assert int(printed[0].split()[1]) > 10


@pytest.mark.parametrize("actions", ["cardinal", "wheels"])
@pytest.mark.parametrize("encoding", ["paper", "expanded"])
def test_observations_stay_in_bounds_and_pellets_are_conserved(encoding: str, actions: str) -> None:
    env = VectorEnv("paper", robots=8, num_envs=8, world="grid", actions=actions, encoding=encoding)
    observation, rng, state = env.reset(), np.random.default_rng(1), env.world.state
    for _ in range(300):
        assert np.isfinite(observation).all()
        assert (observation >= env.layout.low).all()
        assert (observation <= env.layout.high).all()
        observation = env.step(rng.integers(0, 5, (8, 8))).observation
        loose, held, absent = ((state.pellet_status == status).sum(axis=1) for status in PelletStatus)
        assert (loose + held + absent == 60).all()
        assert (state.delivered == state.refilled + absent).all()


def delivered(name: str, arena: str, robots: int, decisions: int, envs: int = 2) -> np.ndarray:
    env = VectorEnv(
        arena, robots=robots, num_envs=envs, episode_steps=decisions, autoreset=False, world="grid"
    )
    observation, team = env.reset(), make_controller(name)
    team.reset(env)
    for _ in range(decisions):
        observation = env.step(team.act(env, observation)).observation
    return env.delivered.sum(axis=1)


@pytest.mark.slow
def test_one_robot_makes_the_trips_of_the_papers_table_on_an_arena_of_the_grids_own() -> None:
    trips = delivered("lanes", "paper-grid", 1, 5000)
    print("trips of one robot:", trips)
    assert ((trips >= 46) & (trips <= 53)).all()


@pytest.mark.slow
def test_two_four_and_eight_robots_do_the_work_of_as_many() -> None:
    """Two lanes carry eight robots without a jam."""
    pellets = {robots: float(delivered("lanes", "paper", robots, 1000).mean()) for robots in (1, 2, 4, 8)}
    print(pellets)
    for robots in (2, 4, 8):
        assert pellets[robots] > 0.93 * robots * pellets[1]


@pytest.mark.parametrize("arena", [name for name in OF_EQUALS if name != "paper"])
def test_lanes_carry_robots_on_every_arena(arena: str) -> None:
    alone, eight = delivered("lanes", arena, 1, 600, envs=1), delivered("lanes", arena, 8, 600, envs=1)
    print(arena, alone, eight)
    # Where nobody can pass they take turns.
    assert eight[0] > (2.5 if arena == "single-lane" else 6.5) * alone[0] > 0


@pytest.mark.parametrize("name", ["active", "reversal", "lorenz"])
def test_robots_without_a_plan_work_alone_and_pass_each_other_where_there_is_room(name: str) -> None:
    alone, four = delivered(name, "paper", 1, 800), delivered(name, "paper", 4, 800)
    print(name, alone, four)
    assert (alone >= 18).all()
    # Of Lorenz's robots the first one always goes, and the others next to never.
    assert (four > (0.9 if name == "lorenz" else 2.5) * alone).all()


def test_active_robots_that_meet_where_nobody_can_pass_stand_there_for_good() -> None:
    drawing = "\n" + "#" * 14 + "\n#HHTTTTTTTTSS#\n" + "#" * 14 + "\n"
    env = VectorEnv(room([(1, 1), (2, 1)], drawing, pellets=4), robots=2, world="grid")
    observation, team = env.reset(), make_controller("active")
    team.reset(env)
    for _ in range(200):
        observation = env.step(team.act(env, observation)).observation
    assert env.dec_pomdp.in_place[0].min() > 100
    assert env.dec_pomdp.truth.blocked.all()


def _runs_in_the_grid(name: str) -> bool:
    """Return whether robots turn by quarters, and are all alike: the grid refuses others in a sentence."""
    card = load_policy(name).card
    return card.env.actions != "wheels-9" and card.arena.groups is None


@pytest.mark.parametrize("name", [name for name in policy_names() if _runs_in_the_grid(name)])
def test_policies_learned_in_physics_run_and_bring_pellets(name: str) -> None:
    team = make_controller(name)
    env = environment_for(team, num_envs=2, world="grid")
    observation = env.reset()
    team.reset(env)
    low, high = env.layout.low, env.layout.high
    for _ in range(400):
        observation = env.step(team.act(env, observation)).observation
        assert np.isfinite(observation).all()
        assert (observation >= low).all()
        assert (observation <= high).all()
    assert env.delivered.sum() > 0


def test_figures_of_forces_are_not_defined_and_all_others_are() -> None:
    """Eight robots without a plan, and one that meets nobody: the same figures are not defined for both."""
    for robots in (1, 8):
        env = VectorEnv("paper", robots=robots, num_envs=1, episode_steps=600, world="grid")
        monitor = TeamMonitor()
        evaluate(make_controller("active"), env, 1, watch=[monitor])
        reasons = {
            summary.metric.name: summary.mean.reason
            for summary in summarise(monitor.episodes)
            if isinstance(summary.mean, NotDefined)
        }
        print(reasons)
        forces = "the grid world knows no forces"
        assert reasons["impulse between robots per trip"] == forces
        assert reasons["wheel energy per pellet"] == forces
        assert reasons["touches of pellets per trip"] == "in the grid world pellets block nobody"
        assert np.isnan([trip.impulse for trip in monitor.episodes[0].trips]).all()
        assert "touches of robots per trip" not in reasons


def test_two_that_stand_head_on_in_a_tunnel_are_a_clog() -> None:
    drawing = "\n" + "#" * 14 + "\n#HHTTTTTTTTSS#\n" + "#" * 14 + "\n"
    env = VectorEnv(
        room([(5, 1), (6, 1)], drawing, pellets=4), robots=2, world="grid", episode_steps=400, autoreset=False
    )
    monitor = TeamMonitor()

    class Facing:
        name = "facing"

        def reset(self, env: VectorEnv) -> None: ...

        def act(self, env: VectorEnv, observation: np.ndarray) -> np.ndarray:
            return np.array([[EAST, WEST]])

    evaluate(Facing(), env, 1, watch=[monitor])
    (clog,) = monitor.episodes[0].standstills
    assert clog.members == (0, 1)
    assert clog.end - clog.start > 380
    # One touch that never ends, counted for both.
    assert monitor.episodes[0].totals.contacts[:, 0].tolist() == [1.0, 1.0]


def test_a_world_that_nobody_knows_is_one_sentence() -> None:
    with pytest.raises(InputError, match='^world is "gird", but must be "physics" or "grid".$'):
        VectorEnv("paper", robots=1, world="gird")  # type: ignore[arg-type]
