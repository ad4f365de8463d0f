"""A recorded trajectory is seed and actions; run again it gives the same bits."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robosim.arena import load_arena, parse_arena
from robosim.control.lanes import LanesController
from robosim.envs.replay import begun, replay
from robosim.envs.trajectory import Trajectory, load_trajectory
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError

VARIED = (
    load_arena("paper").text + "\n[randomisation]\nrobot_mass = [0.5, 2.0]\npellet_friction = [0.5, 2.0]\n"
)


def bits(env: VectorEnv, index: int = 0) -> list[bytes]:
    """What there is of one environment, as bytes."""
    state, frame = env.world.state, env.frame(index)
    contacts = frame.contacts
    arrays = (
        state.pose[index], state.velocity[index], state.pellets[index], state.pellet_status[index],
        state.held[index], frame.mode, frame.reward, frame.delivered, frame.pheromone, frame.action,
        contacts.time, contacts.kind, contacts.a, contacts.b, contacts.position, contacts.impulse,
    )  # fmt: skip
    return [np.ascontiguousarray(array).tobytes() for array in arrays]


@pytest.mark.parametrize(
    ("text", "robots", "kind"),
    [
        (load_arena("paper").text, 8, "cardinal"),
        (load_arena("three-wide").text, 6, "cardinal"),
        (VARIED, 4, "cardinal"),
        (load_arena("single-lane").text, 3, "wheels"),
    ],
)
def test_a_saved_trajectory_runs_again_to_the_last_bit(tmp_path: Path, text, robots, kind) -> None:
    """The second episode of the second of three environments, from a file, in an environment of its own."""
    env = VectorEnv(
        parse_arena(text, "x"), robots=robots, num_envs=3, seed=5, actions=kind, episode_steps=400
    )
    env.reset()
    observation = env.reset()
    controller, rng = LanesController(), np.random.default_rng(0)
    if kind == "cardinal":
        controller.reset(env)
    recorded, seen = [bits(env, 1)], [observation[1].tobytes()]
    for _ in range(200):
        actions = rng.integers(0, 5, (3, robots))
        if kind == "cardinal":
            actions = np.where(rng.random(actions.shape) < 0.2, actions, controller.act(env, observation))
        transition = env.step(actions)
        observation = transition.observation
        recorded.append(bits(env, 1))
        seen.append(observation[1].tobytes() + transition.reward[1].tobytes())
    env.trajectory(1).save(tmp_path / "run.npz")
    trajectory = load_trajectory(tmp_path / "run.npz")
    assert (trajectory.episode, trajectory.robots, trajectory.actions) == (1, robots, kind)
    again = begun(trajectory)
    assert bits(again) == recorded[0]
    for decision, chosen in enumerate(trajectory.chosen, 1):
        transition = again.step(chosen[None])
        assert bits(again) == recorded[decision], decision
        observed = transition.final_observation[0].tobytes() + transition.reward[0].tobytes()
        assert observed == seen[decision], decision


@pytest.mark.parametrize(("name", "robots"), [("paper", 8), ("three-wide", 5)])
def test_an_environment_restored_mid_episode_goes_on_as_the_first_did(name, robots) -> None:
    """Into a fresh environment, with pellets held, in motion and delivered; observations and rewards too."""
    env = VectorEnv(name, robots=robots, num_envs=2, seed=8, episode_steps=600)
    controller = LanesController()
    observation = env.reset()
    controller.reset(env)
    chosen = []
    for decision in range(360):
        if decision == 260:
            snapshot = env.snapshot()
            at_snapshot = observation.tobytes()
        actions = controller.act(env, observation)
        transition = env.step(actions)
        observation = transition.observation
        if decision >= 260:
            chosen.append((actions, bits(env, 0), bits(env, 1), transition))
    assert env.delivered.sum() > 0
    other = VectorEnv(name, robots=robots, num_envs=2, seed=123, episode_steps=600)
    assert other.restore(snapshot).tobytes() == at_snapshot
    for actions, first, second, expected in chosen:
        transition = other.step(actions)
        assert (bits(other, 0), bits(other, 1)) == (first, second)
        assert transition.observation.tobytes() == expected.observation.tobytes()
        assert transition.reward.tobytes() == expected.reward.tobytes()


def test_replay_yields_the_frames_of_the_recording() -> None:
    env = VectorEnv("paper", robots=2, seed=4)
    env.reset()
    rng = np.random.default_rng(1)
    poses = [env.frame().pose.copy()]
    for _ in range(20):
        env.step(rng.integers(0, 5, (1, 2)))
        poses.append(env.frame().pose.copy())
    frames = [(frame.step, frame.pose.copy()) for frame in replay(env.trajectory())]
    assert [step for step, _ in frames] == list(range(21))
    assert all(
        pose.tobytes() == expected.tobytes() for (_, pose), expected in zip(frames, poses, strict=True)
    )


def trajectory(**changes) -> Trajectory:
    fields = {
        "arena": load_arena("paper").text,
        "actions": "cardinal",
        "seed": 2**64 - 1,
        "episode": 0,
        "chosen": np.array([[0, 4], [1, 2]], dtype=np.uint8),
    }
    return Trajectory(**(fields | changes))


def test_a_file_gives_back_what_was_saved(tmp_path: Path) -> None:
    saved = trajectory()
    saved.save(tmp_path / "a.npz")
    loaded = load_trajectory(tmp_path / "a.npz")
    assert (loaded.arena, loaded.actions, loaded.seed, loaded.episode) == (
        saved.arena,
        "cardinal",
        2**64 - 1,
        0,
    )
    assert loaded.chosen.dtype == np.uint8
    assert loaded.chosen.tolist() == saved.chosen.tolist()
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]


def test_what_cannot_be_run_again_is_one_sentence() -> None:
    with pytest.raises(InputError, match="^trajectory: it holds no decisions.$"):
        list(replay(trajectory(chosen=np.zeros((0, 2), dtype=np.uint8))))
    with pytest.raises(InputError, match="^trajectory: this is not TOML"):
        list(replay(trajectory(arena="=")))
    with pytest.raises(InputError, match="^robots: 99 is not allowed"):
        list(replay(trajectory(chosen=np.zeros((1, 99), dtype=np.uint8))))


def written(path: Path, **changes) -> Path:
    fields = {
        "format": np.int64(1),
        "arena": np.frombuffer(b"text", dtype=np.uint8),
        "actions": np.int64(0),
        "seed": np.uint64(3),
        "episode": np.int64(0),
        "chosen": np.zeros((2, 2), dtype=np.uint8),
    } | changes
    with path.open("wb") as file:
        np.savez(file, **{name: value for name, value in fields.items() if value is not None})
    return path


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"seed": None}, "is no trajectory; it lacks seed."),
        ({"format": np.int64(9)}, "format 9 is unknown; known is 1."),
        ({"format": np.float64(1)}, "format must be one whole number from 0."),
        ({"seed": np.int64(-1)}, "seed must be one whole number from 0."),
        ({"episode": np.zeros(2, dtype=np.int64)}, "episode must be one whole number from 0."),
        ({"actions": np.int64(2)}, "actions must be 0 to 1."),
        (
            {"chosen": np.full((2, 2), 5, dtype=np.uint8)},
            "chosen must be bytes [decisions, robots] from 0 to 4.",
        ),
        (
            {"chosen": np.zeros((2, 2), dtype=np.int64)},
            "chosen must be bytes [decisions, robots] from 0 to 4.",
        ),
        ({"chosen": np.zeros(2, dtype=np.uint8)}, "chosen must be bytes [decisions, robots] from 0 to 4."),
        (
            {"chosen": np.zeros((2, 0), dtype=np.uint8)},
            "chosen must be bytes [decisions, robots] from 0 to 4.",
        ),
        ({"chosen": np.array([["x"]])}, "chosen must be bytes [decisions, robots] from 0 to 4."),
        ({"arena": np.array([1.0])}, "arena must be the bytes of a text."),
        ({"arena": np.array([255, 254], dtype=np.uint8)}, "arena must be UTF-8 text."),
    ],
)
def test_a_wrong_file_is_one_sentence(tmp_path: Path, changes, sentence) -> None:
    path = written(tmp_path / "wrong.npz", **changes)
    with pytest.raises(InputError) as caught:
        load_trajectory(path)
    assert str(caught.value) == f"{path}: {sentence}"


def test_no_file_and_a_file_of_something_else_are_one_sentence_and_run_no_code(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.npz: cannot be read \(No such file or directory\)\.$"):
        load_trajectory(tmp_path / "none.npz")
    for name, content in [("text", b"hello"), ("empty", b""), ("cut", b"PK\x03\x04")]:
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=f"{name}: is no trajectory"):
            load_trajectory(tmp_path / name)
    pickled = written(tmp_path / "pickled.npz", chosen=np.array([[print]], dtype=object))
    with pytest.raises(InputError, match=r"pickled\.npz: is no trajectory"):
        load_trajectory(pickled)
    whole = (tmp_path / "pickled.npz").read_bytes()
    (tmp_path / "half.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"half\.npz: is no trajectory"):
        load_trajectory(tmp_path / "half.npz")


@pytest.fixture(scope="module")
def saved(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("saved") / "whole.npz"
    trajectory().save(path)
    return path


@settings(max_examples=200)
@given(
    st.lists(st.tuples(st.floats(0.0, 0.9999), st.integers(0, 255)), min_size=1, max_size=3),
    st.floats(0.0, 5.0),
)
def test_a_damaged_file_is_a_trajectory_or_one_sentence(saved, damage, length) -> None:
    content = bytearray(saved.read_bytes())
    for place, value in damage:
        content[int(place * len(content))] = value
    if length < 1.0:
        del content[int(length * len(content)) :]
    path = saved.with_name("damaged.npz")
    path.write_bytes(content)
    try:
        load_trajectory(path)
    except InputError as refusal:
        assert str(refusal).startswith(f"{path}: ")


def test_a_file_that_claims_to_unpack_to_more_than_fits_is_refused_unread(tmp_path: Path) -> None:
    path = written(tmp_path / "bomb.npz")
    content = bytearray(path.read_bytes())
    entry = content.index(b"PK\x01\x02")
    content[entry + 24 : entry + 28] = (2**31 - 1).to_bytes(4, "little")
    path.write_bytes(content)
    with pytest.raises(InputError, match="too large for a trajectory"):
        load_trajectory(path)
