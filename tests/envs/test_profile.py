"""Profiles: files, names, and environments that run under them."""

import math
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from robosim.arena import load_arena
from robosim.control.controller import make_controller
from robosim.discretise.sensing import ExactSensor
from robosim.envs.config import EnvConfig, env_config
from robosim.envs.mixed import MixedVectorEnv
from robosim.envs.profile import ProfileConfig, load_profile, profile_names, profile_text
from robosim.envs.variety import VarietyConfig
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError
from robosim.experiments.team import Measuring, learning_job, measuring_job
from robosim.learning.config import run_config

GRID = {"motion": {"latency": (0.0, 2.0)}, "sensing": {"position_noise": 0.1, "dropout": 0.2, "delay": 1}}


def history(profile: object, *, envs: int = 2, seed: object = 3, world: str = "physics", steps: int = 40):
    """Bits of observations, rewards and poses [decisions][envs] under actions drawn evenly."""
    env = VectorEnv(
        "paper", robots=4, num_envs=envs, seed=seed, profile=profile, world=world, episode_steps=25
    )
    rngs = [np.random.default_rng(one) for one in env.seeds]
    env.reset()
    found = []
    for _ in range(steps):
        transition = env.step(np.stack([rng.integers(0, 5, 4) for rng in rngs]))
        pose = env.world.state.pose
        parts = (transition.observation, transition.reward, pose, env.world.state.pellets)
        found.append([b"".join(part[one].tobytes() for part in parts) for one in range(envs)])
    return env, found


def test_the_profiles_that_ship_are_sound_and_say_what_they_stand_for() -> None:
    assert profile_names() == ["broad", "harsh", "mocap", "none", "robotarium"]
    for name in profile_names():
        profile = load_profile(name)
        assert profile.name == name
        assert len(profile.description) > 20
        assert ProfileConfig.from_table(profile.model_dump(mode="json"), "again") == profile
    none = load_profile("none")
    assert none.changed(name="", description="") == ProfileConfig()


@pytest.mark.parametrize("world", ["physics", "grid"])
def test_without_a_profile_and_with_none_the_bits_are_the_same(world: str) -> None:
    assert history("none", world=world)[1] == history(None, world=world)[1]


@pytest.mark.parametrize(("profile", "world"), [("harsh", "physics"), ("mocap", "physics"), (GRID, "grid")])
def test_each_environment_is_what_it_would_be_alone_and_again(profile: object, world: str) -> None:
    env, together = history(profile, envs=3, world=world)
    _, alone = history(profile, envs=1, seed=[env.seeds[1]], world=world)
    assert [bits[1] for bits in together] == [bits[0] for bits in alone]
    assert together == history(profile, envs=3, world=world)[1]
    assert together != history(None, envs=3, world=world)[1]


@pytest.mark.parametrize(("profile", "world"), [("harsh", "physics"), (GRID, "grid")])
def test_a_snapshot_is_restored_to_the_bit_under_a_profile(profile: object, world: str) -> None:
    env, _ = history(profile, world=world, steps=37)
    kept = env.snapshot()
    actions = np.random.default_rng(0).integers(0, 5, (10, 2, 4))
    first = [env.step(chosen).observation.tobytes() for chosen in actions]
    other = VectorEnv(env.config, num_envs=2, seed=9)
    other.restore(kept)
    assert [other.step(chosen).observation.tobytes() for chosen in actions] == first


def test_teams_of_several_sizes_run_under_a_profile_and_are_restored_to_the_bit() -> None:
    base = EnvConfig(world="grid", profile=ProfileConfig(**GRID), episode_steps=30)
    variety = VarietyConfig(arenas=("paper", "single-lane"), team_sizes=(1, 3), envs_per_arena=1)
    env = MixedVectorEnv(base, variety, num_envs=2, seed=1)
    env.reset()
    rng = np.random.default_rng(0)
    for _ in range(12):
        env.step(rng.integers(0, 5, (env.num_envs, 1)))
    kept, actions = env.snapshot(), rng.integers(0, 5, (10, env.num_envs, 1))
    first = [env.step(chosen).observation.tobytes() for chosen in actions]
    other = MixedVectorEnv(base, variety, num_envs=2, seed=1)
    other.restore(kept)
    assert [other.step(chosen).observation.tobytes() for chosen in actions] == first


def test_sensing_changes_what_is_seen_and_not_what_is_drawn() -> None:
    seen, exact = VectorEnv("paper", profile={"sensing": {"position_noise": 0.05}}), VectorEnv("paper")
    assert (seen.reset() != exact.reset()).any()
    assert seen.world.state.pose.tobytes() == exact.world.state.pose.tobytes()
    assert seen.world.state.pellets.tobytes() == exact.world.state.pellets.tobytes()


def test_robots_steer_by_where_they_take_themselves_to_be() -> None:
    """With a heading that seems 0 and is not, a command to the east leads astray by just that angle."""

    class Turned:
        def reset(self, seeds):
            pass

        def sense(self, state):
            pose = state.pose.copy()
            pose[..., 2] = 0.0
            return ExactSensor().sense(state)._replace(pose=pose)

    arena = load_arena("paper")
    middle, heading = 2.5 * arena.cell_size, 0.4
    env = VectorEnv(f"{arena.text}\n[start]\nposes = [[{middle}, {middle}, {heading}]]\n", robots=1)
    env._dec._sensor = Turned()
    env.reset()
    before = env.world.state.pose[0, 0, :2].copy()
    env.step([[3]])
    moved = env.world.state.pose[0, 0, :2] - before
    assert math.atan2(moved[1], moved[0]) == pytest.approx(heading, abs=0.03)


def test_a_team_still_delivers_under_the_profiles_that_ship() -> None:
    for name in ("mocap", "robotarium", "harsh"):
        env = VectorEnv("paper", robots=4, seed=3, profile=name, autoreset=False)
        lanes, observation = make_controller("lanes"), env.reset()
        lanes.reset(env)
        while not env.delivered.any():
            observation = env.step(lanes.act(env, observation)).observation
            assert env.steps_taken < 300, name


def test_the_keys_of_jobs_without_a_profile_are_what_they_were() -> None:
    learned = learning_job(run_config("smadrl", robots=4, steps=1000, seed=3), Measuring(episodes=3))
    assert learned.key == "d6e671948ec5c14b10f832c9c3ed80824b86a645810c66a2759167abdcd50f26"
    measured = measuring_job("lanes", EnvConfig(robots=4), 3, Measuring(episodes=3))
    assert measured.key == "8ef7c4ecd6934772767dc2c48512cb6b34c3346df037a719c0d5d39e89a15ce8"
    harsh = run_config("smadrl", robots=4, steps=1000, seed=3, profile="harsh")
    assert learning_job(harsh, Measuring(episodes=3)).key != learned.key
    assert (
        measuring_job("lanes", EnvConfig(), 3, Measuring(profile="harsh")).config["evaluation"]["profile"]
        == "harsh"
    )


def test_a_profile_is_given_by_name_path_text_or_whole_and_its_fields_by_short_names(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('name = "mine"\n[sensing]\ndelay = 2\n')
    whole = ProfileConfig(name="mine", sensing={"delay": 2})
    for one in (str(file), file, file.read_text(), whole, whole.model_dump()):
        config, _ = env_config("paper", profile=one)
        assert config.profile == whole
    config, _ = env_config("paper", sensing_delay=2, motion_jitter=0.1)
    assert config.profile == ProfileConfig(sensing={"delay": 2}, motion={"jitter": 0.1})
    config, _ = env_config("paper", profile="harsh", sensing_delay=5)
    harsh = load_profile("harsh")
    assert config.profile == harsh.changed(name="harsh, changed", sensing=harsh.sensing.changed(delay=5))
    assert profile_text("harsh") == "harsh"
    assert load_profile(profile_text(str(file))) == whole


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            "[motion]\nlatency = [0.2, 0.1]",
            "motion: latency is [0.2, 0.1], but the first must be at most the second.",
        ),
        (
            "[motion]\nrobot_mass = [nan, 1]",
            "motion.robot_mass is nan, but must be a list of 2 numbers from 0.1 to 10.",
        ),
        (
            "[motion]\nrobot_mass = [0, 1]",
            "motion.robot_mass is 0, but must be a list of 2 numbers from 0.1 to 10.",
        ),
        (
            "[motion]\nlag = [0, 1]",
            '"lag" is not an option of motion: did you mean motor_lag or latency?',
        ),
        (
            "[sensing]\ndelay = 1.5",
            "sensing.delay is 1.5, but must be a whole number from 0 to 100.",
        ),
        (
            "[sensing]\ndropout = 2",
            "sensing.dropout is 2, but must be a number from 0 to 1.",
        ),
        ("sensing = 3", "sensing is 3, but must be a table."),
        (
            "[sensing",
            "not a TOML file (Expected ']' at the end of a table declaration (at end of document)).",
        ),
    ],
)  # fmt: skip
def test_each_mistake_is_one_sentence(tmp_path: Path, text: str, sentence: str) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(text)
    with pytest.raises(InputError) as refusal:
        load_profile(file)
    assert str(refusal.value) == f"{file}: {sentence}"


def test_a_profile_that_is_not_there_is_one_sentence(tmp_path: Path) -> None:
    for one, sentence in (
        ("hars", "No profile is named 'hars': did you mean harsh?"),
        (tmp_path, f"{tmp_path}: this is a directory; a profile is needed here."),
        (tmp_path / "no.toml", f"{tmp_path / 'no.toml'}: there is no such profile."),
    ):
        with pytest.raises(InputError) as refusal:
            load_profile(one)
        assert str(refusal.value) == sentence


NUMBERS = st.floats(allow_nan=True) | st.integers(-(10**20), 10**20) | st.floats(0, 2) | st.booleans()
VALUES = (
    NUMBERS | st.lists(NUMBERS, max_size=3) | st.text(max_size=5) | st.tuples(st.just(0.5), st.floats(0, 3))
)
KEYS = st.sampled_from(
    [
        *ProfileConfig().motion.model_dump(), *ProfileConfig().sensing.model_dump(),
        *ProfileConfig().pheromones.model_dump(), "wheel",
    ]
)  # fmt: skip


@given(
    st.dictionaries(
        st.sampled_from(["motion", "sensing", "pheromones", "name", "noise"]),
        st.dictionaries(KEYS, VALUES, max_size=3) | VALUES,
        max_size=3,
    )
)
@settings(max_examples=150, deadline=None)
def test_whatever_a_file_holds_it_is_a_sound_profile_or_one_sentence(table) -> None:
    text = tomli_w.dumps(table) + "\n\n"
    try:
        profile = load_profile(text)
    except InputError as error:
        assert "\n" not in str(error)
        assert str(error).startswith("profile: ")
        return
    numbers = [
        number
        for part in (profile.motion, profile.sensing, profile.pheromones)
        for value in part.model_dump().values()
        for number in (value if isinstance(value, tuple) else (value,))
        if number is not None
    ]
    assert all(math.isfinite(number) for number in numbers)
    assert ProfileConfig.from_table(profile.model_dump(mode="json"), "again") == profile
