"""The lane keeper brings pellets home on every arena, and scales with the team where there is room."""

import numpy as np
import pytest

from robosim.arena import arena_names, load_arena, parse_arena
from robosim.control.lanes import LanesController
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError


def run(arena, robots: int, envs: int, decisions: int, seed: int, parts: int = 1) -> np.ndarray:
    """Return pellets delivered [parts, envs] in equal parts of an episode."""
    env = VectorEnv(arena, robots=robots, num_envs=envs, seed=seed, episode_steps=decisions, autoreset=False)
    controller = LanesController()
    observation = env.reset()
    controller.reset(env)
    sums = [np.zeros(envs, dtype=np.int64)]
    for decision in range(1, decisions + 1):
        observation = env.step(controller.act(env, observation)).observation
        if decision * parts % decisions < parts:
            sums.append(env.delivered.sum(axis=1))
    return np.diff(np.array(sums), axis=0)


@pytest.fixture(scope="module")
def trips_of_one() -> np.ndarray:
    return run("paper", 1, 3, 5000, seed=21).sum(axis=0)


@pytest.mark.slow
def test_one_robot_on_paper_makes_the_trips_of_the_papers_table(trips_of_one) -> None:
    print(f"one robot: {trips_of_one.tolist()} trips in 5000 decisions")
    assert ((trips_of_one >= 44) & (trips_of_one <= 48)).all()


@pytest.mark.slow
def test_eight_robots_on_paper_do_seven_times_the_work_of_one(trips_of_one) -> None:
    trips = run("paper", 8, 3, 5000, seed=21).sum(axis=0)
    ratio = trips / trips_of_one.mean()
    print(
        f"eight robots: {trips.tolist()} trips in 5000 decisions, {ratio.round(2).tolist()} times one robot's"
    )
    assert (ratio >= 7.0).all()


QUICK = ("single-lane", "relay")


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in arena_names()],
)
def test_four_robots_on_every_arena_never_stand_still_for_good(name) -> None:
    """Something is delivered in each third of 1500 decisions, by every one of three teams."""
    trips = run(name, 4, 3, 1500, seed=5, parts=3)
    print(f"{name}: deliveries in thirds of 1500 decisions {trips.tolist()}")
    assert trips.shape == (3, 3)
    assert (trips > 0).all()


@pytest.mark.parametrize("name", ["single-lane", pytest.param("three-wide", marks=pytest.mark.slow)])
def test_a_batch_is_driven_as_its_members_alone(name) -> None:
    """Nothing of one environment reaches another, gates and patience included."""
    env = VectorEnv(name, robots=5, num_envs=3, seed=2, episode_steps=300, autoreset=False)
    alone = [VectorEnv(name, robots=5, seed=[seed], episode_steps=300, autoreset=False) for seed in env.seeds]
    controllers = [LanesController() for _ in range(4)]
    for one, controller in zip([env, *alone], controllers, strict=True):
        one.reset()
        controller.reset(one)
    for _ in range(300):
        actions = controllers[0].act(env, np.zeros(0, dtype=np.float32))
        for index, one in enumerate(alone):
            own = controllers[1 + index].act(one, np.zeros(0, dtype=np.float32))
            assert own[0].tolist() == actions[index].tolist()
            one.step(own)
        env.step(actions)


def test_a_mirrored_arena_is_worked_as_well() -> None:
    """Home on the right, source on the left."""
    text = load_arena("paper").text
    lines = [line[::-1] if line.startswith("#") and line.endswith("#") else line for line in text.split("\n")]
    mirrored = parse_arena("\n".join(lines), "mirrored")
    plain = run("paper", 4, 4, 800, seed=6).sum()
    other = run(mirrored, 4, 4, 800, seed=6).sum()
    print(f"four robots deliver {plain} on paper, {other} on its mirror image")
    assert other == pytest.approx(plain, rel=0.08)


def test_it_drives_by_cardinal_actions_only() -> None:
    env = VectorEnv("paper", robots=1, actions="wheels")
    env.reset()
    with pytest.raises(InputError) as caught:
        LanesController().reset(env)
    assert str(caught.value) == (
        "lanes: drives by cardinal actions only, and the environment's actions are 'wheels'."
    )


@pytest.mark.parametrize("robots", [1, 35])
def test_any_team_gets_actions_in_range(robots) -> None:
    env = VectorEnv("paper", robots=robots, num_envs=2, seed=1)
    observation = env.reset()
    controller = LanesController()
    controller.reset(env)
    for _ in range(60):
        actions = controller.act(env, observation)
        assert actions.shape == (2, robots)
        assert actions.dtype == np.int64
        assert ((actions >= 0) & (actions <= 4)).all()
        observation = env.step(actions).observation
