import math
import signal
from copy import deepcopy
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import robosim.envs.gym_env
from robosim.arena import Arena, load_arena, parse_arena
from robosim.control.controller import make_controller
from robosim.envs.vector import Snapshot, Transition, VectorEnv
from robosim.errors import InputError, shown
from robosim.robot.drivers import ACTION_NAMES

VARIED = parse_arena(
    load_arena("paper").text
    + "\n[randomisation]\nwheel_speed = [0.7, 1.2]\ntraction = [0.5, 1.0]\npellet_mass = [0.5, 2.0]\n",
    "varied.toml",
)
SEEDS = "a whole number from 0 to 18446744073709551615."


def refused(sentence: str, call: Any, *args: Any, **options: Any) -> None:
    with pytest.raises(InputError) as refusal:
        call(*args, **options)
    assert str(refusal.value) == sentence


def random_actions(envs: int, robots: int, steps: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 5, (steps, envs, robots))


def lane_actions(env: VectorEnv, steps: int) -> np.ndarray:
    """What the lane keeper does, now and then a robot at random: so that robots carry, meet and lose."""
    rng = np.random.default_rng(1)
    observation = env.reset()
    lanes = make_controller("lanes")
    lanes.reset(env)
    chosen = []
    for _ in range(steps):
        actions = lanes.act(env, observation)
        careless = rng.random(actions.shape) < 0.1
        chosen.append(np.where(careless, rng.integers(0, 5, actions.shape), actions))
        observation = env.step(chosen[-1]).observation
    return np.stack(chosen)


def played(env: VectorEnv, actions: np.ndarray) -> dict[str, np.ndarray]:
    """Everything that comes of the actions [steps, envs, robots], stacked to [envs, steps, ...]."""
    seen: dict[str, list[Any]] = {}
    for chosen in actions:
        transition = env.step(chosen)
        state = env.world.state
        now = transition._asdict() | {
            "pose": state.pose, "velocity": state.velocity, "pellets": state.pellets, "held": state.held,
            "modes": env.dec_pomdp.shown_mode, "delivered": env.delivered,
            "pheromone": env.dec_pomdp.pheromone.occupancy,
        }  # fmt: skip
        for name, value in now.items():
            seen.setdefault(name, []).append(np.array(value))
    return {name: np.stack(values, axis=1) for name, values in seen.items()}


def assert_same(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> None:
    assert one.keys() == other.keys()
    for name, value in one.items():
        assert value.tobytes() == other[name].tobytes(), name


@pytest.mark.parametrize(
    ("arena", "robots", "options"),
    [
        ("paper", 5, {}),
        ("single-lane", 3, {"encoding": "paper", "reward": "local"}),
        ("three-wide", 6, {"stigmergy": False, "sharing": "split"}),
        ("paper", 3, {"actions": "wheels"}),
        (VARIED, 3, {}),
    ],
)
def test_a_batch_gives_what_its_environments_give_alone(
    arena: str | Arena, robots: int, options: dict[str, Any]
) -> None:
    """To the last bit, and across the ends of episodes."""
    steps = 130
    batch = VectorEnv(arena, robots=robots, num_envs=3, seed=11, episode_steps=50, **options)
    first = batch.reset()
    if options.get("actions") == "wheels":
        actions = random_actions(3, robots, steps)
    else:
        long = VectorEnv(arena, robots=robots, num_envs=3, seed=11, episode_steps=steps, **options)
        actions = lane_actions(long, steps)
    together = played(batch, actions)
    assert together["truncated"].sum() == 3 * 2
    for env in range(3):
        alone = VectorEnv(
            arena, robots=robots, num_envs=1, seed=[batch.seeds[env]], episode_steps=50, **options
        )
        assert alone.reset().tobytes() == first[env : env + 1].tobytes()
        mine = {name: value[env : env + 1] for name, value in together.items()}
        assert_same(mine, played(alone, actions[:, env : env + 1]))


def test_a_full_batch_of_sixteen_agrees_with_its_members() -> None:
    actions = random_actions(16, 8, 12)
    batch = VectorEnv("paper", robots=8, num_envs=16, seed=2)
    batch.reset()
    together = played(batch, actions)
    for env in (0, 7, 15):
        alone = VectorEnv("paper", robots=8, seed=[batch.seeds[env]])
        alone.reset()
        mine = {name: value[env : env + 1] for name, value in together.items()}
        assert_same(mine, played(alone, actions[:, env : env + 1]))


def test_the_same_seed_and_actions_give_the_same_bits() -> None:
    actions = random_actions(2, 4, 60)
    envs = [VectorEnv("paper", robots=4, num_envs=2, seed=5, episode_steps=25) for _ in range(2)]
    assert envs[0].reset().tobytes() == envs[1].reset().tobytes()
    once, again = (played(env, actions) for env in envs)
    assert_same(once, again)
    envs[0].reset(5)
    assert_same(once, played(envs[0], actions))


def test_environments_and_episodes_differ() -> None:
    env = VectorEnv("paper", robots=4, num_envs=4, seed=0)
    assert len(set(env.seeds)) == 4
    starts = [env.reset() for _ in range(3)]
    poses = {start[index].tobytes() for start in starts for index in range(4)}
    assert len(poses) == 12
    assert env.seeds != VectorEnv("paper", robots=4, num_envs=4, seed=1).seeds


def test_reset_with_a_seed_begins_again_and_without_goes_on() -> None:
    env = VectorEnv("paper", robots=2, num_envs=2, seed=9)
    episodes = [env.reset() for _ in range(3)]
    assert env.episode == 2
    assert_array_equal(env.reset(9), episodes[0])
    assert env.episode == 0
    assert_array_equal(env.reset(), episodes[1])
    assert_array_equal(env.reset(), episodes[2])
    assert not np.array_equal(env.reset(10), episodes[0])
    assert_array_equal(env.reset(list(VectorEnv("paper", robots=2, num_envs=2, seed=9).seeds)), episodes[0])


def test_an_environments_seed_does_not_depend_on_the_size_of_the_batch() -> None:
    small = VectorEnv("paper", robots=1, num_envs=2, seed=3).seeds
    assert VectorEnv("paper", robots=1, num_envs=5, seed=3).seeds[:2] == small


def test_episodes_end_by_truncation_and_the_next_begin_at_once() -> None:
    env = VectorEnv("paper", robots=3, num_envs=2, episode_steps=4)
    alone = VectorEnv("paper", robots=3, num_envs=2, episode_steps=4, autoreset=False)
    assert_array_equal(env.reset(1), alone.reset(1))
    for step, actions in enumerate(random_actions(2, 3, 12), start=1):
        transition, last = env.step(actions), alone.step(actions)
        ended = step % 4 == 0
        assert transition.terminated.tolist() == [False, False]
        assert transition.truncated.tolist() == last.truncated.tolist() == [ended, ended]
        assert_array_equal(transition.final_observation, last.observation)
        assert_array_equal(transition.reward, last.reward)
        assert_array_equal(transition.final_delivered, last.final_delivered)
        if ended:
            assert (env.episode, env.steps_taken) == (step // 4, 0)
            assert alone.steps_taken == 4
            assert_array_equal(transition.observation, alone.reset())
            assert not np.array_equal(transition.observation, transition.final_observation)
        else:
            assert_array_equal(transition.observation, transition.final_observation)


def test_deliveries_are_counted_per_robot_and_episode() -> None:
    env = VectorEnv("paper", robots=3, num_envs=2, episode_steps=300, seed=4)
    observation = env.reset()
    lanes = make_controller("lanes")
    lanes.reset(env)
    total = np.zeros((2, 3), dtype=np.int64)
    returned = []
    for step in range(1, 301):
        transition = env.step(lanes.act(env, observation))
        observation = transition.observation
        if step < 300:
            total += env.world.state.deliveries
            assert_array_equal(transition.final_delivered, total)
            assert_array_equal(env.delivered, total)
            returned.append((transition.final_delivered, total.copy()))
    assert (transition.final_delivered >= total).all()
    assert transition.final_delivered.sum() >= 6
    for array, then in returned:
        assert_array_equal(array, then)
    assert not env.delivered.any()


def test_a_step_changes_no_array_that_was_handed_in_or_out_before() -> None:
    env = VectorEnv("paper", robots=3, num_envs=2, episode_steps=20)
    handed: list[tuple[np.ndarray, np.ndarray]] = []

    def keep(array: np.ndarray) -> None:
        handed.append((array, array.copy()))

    keep(env.reset(0))
    for actions in random_actions(2, 3, 50):
        actions = actions.astype(np.uint8)
        keep(actions)
        for array in env.step(actions):
            keep(array)
        keep(env.delivered)
        keep(env.snapshot().actions)
    for array, copy in handed:
        assert_array_equal(array, copy)


def test_actions_may_be_any_integers_and_are_not_kept() -> None:
    one, other = (VectorEnv("paper", robots=2, num_envs=1) for _ in range(2))
    one.reset(0)
    other.reset(0)
    chosen = np.array([[3, 2]], dtype=np.int8)
    first = one.step(chosen)
    chosen[:] = 0
    assert_array_equal(first.observation, other.step([[3, 2]]).observation)
    assert one.frame().action.tolist() == [3, 2]


@pytest.mark.parametrize("arena", ["paper", "three-wide"])
def test_a_snapshot_brings_back_the_moment_to_the_last_bit(arena: str) -> None:
    env = VectorEnv(arena, robots=4, num_envs=2, seed=6, episode_steps=100)
    env.reset()
    actions = lane_actions(VectorEnv(arena, robots=4, num_envs=2, seed=6, episode_steps=1000), 180)
    at = played(env, actions[:130])["observation"][:, -1]  # into the second episode
    moment = env.snapshot()
    once = played(env, actions[130:])
    assert_array_equal(env.restore(moment), at)
    assert (env.episode, env.steps_taken, env.autoreset) == (1, 30, True)
    assert_same(once, played(env, actions[130:]))
    other = VectorEnv(arena, robots=4, num_envs=2, seed=0, episode_steps=100)
    assert_array_equal(other.restore(moment), at)
    assert_same(once, played(other, actions[130:]))


def test_a_snapshot_at_the_end_of_an_episode_waits_for_reset() -> None:
    env = VectorEnv("paper", robots=2, episode_steps=6, autoreset=False)
    env.reset(0)
    last = played(env, random_actions(1, 2, 6))
    moment = env.snapshot()
    following = env.reset()
    assert_array_equal(env.restore(moment), last["observation"][:, -1])
    assert_array_equal(env.reset(), following)


def test_a_snapshot_right_after_reset_is_the_start() -> None:
    env = VectorEnv("paper", robots=2, seed=1)
    start = env.reset()
    moment = env.snapshot()
    played(env, random_actions(1, 2, 5))
    assert_array_equal(env.restore(moment), start)


def test_a_trajectory_runs_again_alone() -> None:
    env = VectorEnv("paper", robots=3, num_envs=2, seed=8, episode_steps=40)
    env.reset()
    seen = played(env, random_actions(2, 3, 70))
    trajectory = env.trajectory(1)
    assert (trajectory.seed, trajectory.episode, trajectory.robots) == (env.seeds[1], 1, 3)
    again = VectorEnv(parse_arena(trajectory.config.arena, "paper.toml"), robots=3, seed=[trajectory.seed])
    again.reset()
    again.reset()
    poses = played(again, trajectory.chosen[:, None])["pose"]
    assert poses.shape[1] == 30
    assert poses.tobytes() == seen["pose"][1:, 40:].tobytes()


def test_an_episode_longer_than_a_thousand_decisions_keeps_its_whole_history() -> None:
    env = VectorEnv("single-lane", robots=1, num_envs=1, episode_steps=3000)
    env.reset(0)
    actions = random_actions(1, 1, 1100).astype(np.uint8)
    poses = played(env, actions)["pose"]
    moment = env.snapshot()
    assert_array_equal(moment.actions, actions)
    env.restore(moment)
    assert env.world.state.pose.tobytes() == poses[:, -1].tobytes()
    env.reset()
    played(env, actions[:5])
    assert_array_equal(env.snapshot().actions, actions[:5])


def test_as_many_robots_as_fit_and_one_alone_both_run() -> None:
    for name in ("paper", "three-wide"):
        arena = load_arena(name)
        for robots in (1, arena.capacity):
            env = VectorEnv(arena, robots=robots, num_envs=2)
            observation = env.reset(0)
            assert observation.shape == (2, robots, env.layout.size)
            seen = played(env, random_actions(2, robots, 10))
            assert (seen["observation"] >= env.layout.low).all()
            assert (seen["observation"] <= env.layout.high).all()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"robots": 0}, "robots is 0, but must be a whole number from 1 to 1000."),
        (
            {"robots": 36},
            "robots is 36, but must be a whole number from 1 to 35, the room in arena 'paper'.",
        ),
        ({"robots": -1}, "robots is -1, but must be a whole number from 1 to 1000."),
        ({"robots": True}, "robots is true, but must be a whole number from 1 to 1000."),
        ({"robots": 2.0}, "robots is 2.0, but must be a whole number from 1 to 1000."),
        ({"robots": "2"}, 'robots is "2", but must be a whole number from 1 to 1000.'),
        ({"num_envs": 0}, "num_envs is 0, but must be a whole number from 1 to 4096."),
        ({"num_envs": 5000}, "num_envs is 5000, but must be a whole number from 1 to 4096."),
        ({"pellet_gradient": -1}, "pellet_gradient is -1, but must be a number from 0 to 50."),
        (
            {"pellet_gradient": math.nan},
            "pellet_gradient is nan, but must be a number from 0 to 50.",
        ),
        (
            {"pellet_gradient": True},
            "pellet_gradient is true, but must be a number from 0 to 50.",
        ),
        ({"pellet_gradient": "8"}, 'pellet_gradient is "8", but must be a number from 0 to 50.'),
        ({"idle_cost": 1}, "reward.idle_cost is 1, but must be true or false."),
        ({"num_envs": 1.5}, "num_envs is 1.5, but must be a whole number from 1 to 4096."),
        ({"seed": -1}, f"seed is -1, but must be {SEEDS}"),
        ({"seed": 2**64}, f"seed is 18446744073709551616, but must be {SEEDS}"),
        ({"seed": 1.0}, f"seed is 1.0, but must be {SEEDS}"),
        ({"seed": False}, f"seed is false, but must be {SEEDS}"),
        ({"seed": "abc"}, f'seed is "abc", but must be {SEEDS}'),
        ({"seed": None}, f"seed is None, but must be {SEEDS}"),
        ({"seed": [1, -2]}, f"seed is -2, but must be {SEEDS}"),
        ({"seed": [1, 2, 3]}, "seed has 3 numbers, but must be one, or one for each of 2 envs."),
        ({"seed": []}, "seed has 0 numbers, but must be one, or one for each of 2 envs."),
        (
            {"episode_steps": -1},
            "episode_steps is -1, but must be a whole number from 0 to 100000000.",
        ),
        (
            {"episode_steps": 1e3},
            "episode_steps is 1000.0, but must be a whole number from 0 to 100000000.",
        ),
        ({"encoding": "raw"}, 'encoding is "raw", but must be "paper" or "expanded".'),
        ({"actions": "north"}, 'actions is "north", but must be "cardinal" or "wheels" or "wheels-9".'),
        ({"reward": "team"}, 'reward.kind is "team", but must be "local" or "global".'),
        ({"collision_weight": -1}, "reward.collision_weight is -1, but must be a number from 0 to 1e+06."),
        ({"pheromone_decay": 2}, "pheromone.decay is 2, but must be a number from 1e-06 to 1."),
        (
            {"profil": "mocap"},
            '"profil" is not an option: did you mean profile or profile_name or profile_description?',
        ),
        ({"warld": 2}, '"warld" is not an option: did you mean world or reward or extra_reward?'),
        ({"warld": None}, '"warld" is not an option: did you mean world or reward or extra_reward?'),
        ({"pheromone": {"radius": 1}}, "pheromone is a table, but must be a PheromoneConfig."),
        ({"sharing": "equal"}, 'reward.sharing is "equal", but must be "copied" or "split".'),
        ({"stigmergy": "yes"}, 'stigmergy is "yes", but must be true or false.'),
        ({"autoreset": 1}, "autoreset is 1, but must be true or false."),
        ({"arena": "papr"}, "No arena is named 'papr': did you mean paper or paper-grid?"),
    ],
)
def test_a_wrong_option_is_one_sentence(options: dict[str, Any], sentence: str) -> None:
    given = {"arena": "paper", "robots": 2, "num_envs": 2} | options
    refused(sentence, VectorEnv, given.pop("arena"), **given)


def test_an_unknown_arena_is_offered_the_nearest_names() -> None:
    with pytest.raises(InputError, match=r"^No arena is named 'single lane': did you mean single-lane"):
        VectorEnv("single lane", robots=1)


@pytest.mark.parametrize(
    ("actions", "sentence"),
    [
        ([0, 1, 2], "has the shape [3]"),
        (np.zeros((3, 2), int), "has the shape [3, 2]"),
        (np.zeros((2, 3, 1), int), "has the shape [2, 3, 1]"),
        (4, "has the shape []"),
        ([[0, 1, 2], [0, 1]], "has rows of unequal length"),
        (np.zeros((2, 3)), "is of type float64"),
        (np.full((2, 3), np.nan), "is of type float64"),
        (np.zeros((2, 3), bool), "is of type bool"),
        (np.full((2, 3), None), "is of type object"),
        (np.full((2, 3), "0"), "is of type <U1"),
        ([[0, 1, 2], [0, 5, 9]], "holds 5"),
        ([[0, 1, 2], [0, -1, 0]], "holds -1"),
        (
            np.full((2, 3), 2**64 - 1, dtype=np.uint64),
            "holds 18446744073709551615",
        ),
    ],
)
def test_wrong_actions_are_one_sentence_and_do_nothing(actions: Any, sentence: str) -> None:
    env = VectorEnv("paper", robots=3, num_envs=2)
    env.reset(0)
    pose = env.world.state.pose.copy()
    whole = f"actions {sentence}, but must be whole numbers from 0 to 4, [envs, robots] = [2, 3]."
    refused(whole, env.step, actions)
    assert env.steps_taken == 0
    assert_array_equal(env.world.state.pose, pose)
    assert isinstance(env.step(np.full((2, 3), 4)), Transition)


def test_each_kind_of_actions_has_as_many_as_it_names() -> None:
    for kind, names in ACTION_NAMES.items():
        env = VectorEnv("paper", robots=2, actions=kind)
        env.reset()
        last = len(names) - 1
        assert env.num_actions == len(names)
        env.step([[last, last]])
        whole = f"whole numbers from 0 to {last}, [envs, robots] = [1, 2]."
        refused(f"actions holds {last + 1}, but must be {whole}", env.step, [[0, last + 1]])


def test_what_comes_before_reset_or_after_the_end_is_one_sentence() -> None:
    env = VectorEnv("paper", robots=1, episode_steps=2, autoreset=False)
    refused("step: no episode has begun; call reset first.", env.step, [[0]])
    refused("snapshot: no episode has begun; call reset first.", env.snapshot)
    refused("frame: no episode has begun; call reset first.", env.frame)
    refused("trajectory: no episode has begun; call reset first.", env.trajectory)
    env.reset()
    env.step([[0]])
    env.step([[0]])
    refused("step: the episode has ended after 2 decisions; call reset to begin another.", env.step, [[0]])
    env.reset()
    env.step([[0]])


@pytest.mark.parametrize("env", [9, -1, "x", 0.0, True, None, [0]])
def test_an_environment_that_there_is_not_is_one_sentence(env: Any) -> None:
    batch = VectorEnv("paper", robots=1, num_envs=2)
    batch.reset()
    for what in (batch.frame, batch.trajectory):
        sentence = f"{what.__name__}: env is {shown(env)}, but must be a whole number from 0 to 1."
        refused(sentence, what, env)


def test_what_is_no_snapshot_is_one_sentence() -> None:
    env = VectorEnv("paper", robots=1)
    refused("snapshot is 5, but must be what `snapshot` returned.", env.restore, 5)


def test_snapshots_and_trajectories_are_equal_by_value() -> None:
    env = VectorEnv("paper", robots=2)
    env.reset()
    env.step([[0, 1]])
    moment, run, frame = env.snapshot(), env.trajectory(), deepcopy(env.frame())
    assert (env.snapshot(), env.trajectory(), env.frame()) == (moment, run, frame)
    env.step([[0, 1]])
    assert env.snapshot() != moment
    assert env.trajectory() != run
    assert env.frame() != frame


def test_a_wrong_seed_for_reset_leaves_the_environment_as_it_was() -> None:
    env = VectorEnv("paper", robots=1, seed=3)
    env.reset()
    seeds = env.seeds
    refused(f"seed is -5, but must be {SEEDS}", env.reset, -5)
    refused("seed has 2 numbers, but must be one, or one for each of 1 envs.", env.reset, [1, 2])
    assert (env.seeds, env.episode) == (seeds, 0)


def test_a_snapshot_that_does_not_fit_is_one_sentence() -> None:
    env = VectorEnv("paper", robots=2, num_envs=2, episode_steps=10)
    env.reset()
    refused(
        "snapshot: it holds [envs, robots] = [1, 2], this environment has [2, 2].",
        env.restore,
        Snapshot((1,), 0, np.zeros((3, 1, 2), dtype=np.uint8)),
    )
    refused(
        "snapshot: it holds 11 decisions, an episode here has 10.",
        env.restore,
        Snapshot((1, 2), 0, np.zeros((11, 2, 2), dtype=np.uint8)),
    )


def test_the_last_decision_of_an_episode_counts_its_collisions_although_the_next_has_begun() -> None:
    options = {"robots": 30, "num_envs": 3, "seed": 2, "episode_steps": 40}
    running, ending = VectorEnv("paper", **options), VectorEnv("paper", **options, autoreset=False)
    running.reset()
    ending.reset()
    actions = np.random.default_rng(0).integers(0, 4, (1, 3, 30)).repeat(40, axis=0)
    for chosen in actions:
        one, other = running.step(chosen), ending.step(chosen)
        assert_array_equal(one.collided, other.collided)
        assert_array_equal(one.blocked, other.blocked)
    assert one.truncated.all()
    assert one.collided.any()
    assert one.blocked.any()
    assert not running.dec_pomdp.truth.collided.any()


def test_weights_and_values_of_rewards_are_options_of_every_face() -> None:
    """With all weights but that of collisions at nothing, rewards count collisions alone."""
    weights = {"distance_weight": 0.0, "pickup_weight": 0.0, "delivery_weight": 0.0}
    options = {"collision_weight": 1.0, "reward_collision": -3.0, **weights}
    actions = np.random.default_rng(0).integers(0, 4, (60, 1, 8))
    env = VectorEnv("paper", robots=8, seed=[5], **options)
    team = robosim.parallel_env("paper", robots=8, **options)
    one = robosim.envs.gym_env.ExcavationEnv("paper", robots=8, others="random", **options)
    env.reset()
    unladen = env.world.state.held < 0
    paid = 0.0
    for chosen in actions:
        transition = env.step(chosen)
        assert_array_equal(transition.reward, -3.0 * (transition.collided & unladen))
        unladen = env.world.state.held < 0
        paid += float(transition.reward.sum())
    assert paid < -10.0
    assert team._batch.config.reward == env.config.reward
    assert one._batch.config.reward == env.config.reward.changed(kind="local")


def test_a_decision_broken_off_leaves_an_environment_that_says_so() -> None:
    env = VectorEnv("paper", robots=8, num_envs=64, seed=3)
    observation = env.reset()
    stay = np.full((64, 8), 4)

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    handler = signal.signal(signal.SIGVTALRM, interrupt)
    try:
        # Of the processor's time; a decision of so many robots takes several times as long.
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.01)
        with pytest.raises(KeyboardInterrupt):
            env.step(stay)
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, handler)
    for what, call in (
        ("step", lambda: env.step(stay)),
        ("snapshot", env.snapshot),
        ("frame", env.frame),
        ("trajectory", env.trajectory),
    ):
        with pytest.raises(InputError) as caught:
            call()
        assert str(caught.value) == (
            f"{what}: a decision was interrupted, and the environment is in its midst; call reset or restore."
        )
    assert env.reset(3).tolist() == observation.tolist()
    env.step(stay)


def test_what_a_step_returns_is_the_callers_own() -> None:
    env = VectorEnv("paper", robots=2, num_envs=2, seed=3)
    env.reset()
    transition = env.step(np.full((2, 2), 4))
    before = transition.final_observation.copy()
    transition.observation[...] = 7.0
    transition.final_delivered[...] = 99
    assert transition.final_observation.tolist() == before.tolist()
    assert not env.delivered.any()


def test_maps_of_pheromones_too_large_for_a_machine_are_refused() -> None:
    with pytest.raises(InputError, match=r"^num_envs is 4096, .* \d+ numbers in a map"):
        VectorEnv("paper", robots=1, num_envs=4096, stigmergy=False, pheromone_radius=200)


def test_on_wheels_a_robot_that_drives_from_cell_to_cell_is_never_in_place() -> None:
    arena = load_arena("paper").text.replace(
        "[pellets]", "[start]\nposes = [[1.05, 0.675, 0.0]]\n\n[pellets]"
    )
    env = VectorEnv(arena, robots=1, world="grid", actions="wheels")
    env.reset()
    for _ in range(12):
        before = env.world.state.pose[0, 0, :2].copy()
        env.step([[0]])
        moved = np.hypot(*(env.world.state.pose[0, 0, :2] - before)) > 0.1
        assert env.dec_pomdp.in_place[0, 0] == (0 if moved else 1)
        assert moved


@pytest.mark.parametrize("seed", [np.array(5), np.int64(5)])
def test_an_array_without_axes_is_a_seed(seed) -> None:
    assert VectorEnv("paper", seed=seed).seeds == VectorEnv("paper", seed=5).seeds
