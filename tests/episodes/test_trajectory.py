"""A recorded trajectory is seed and actions; run again it gives the same bits."""

import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from robosim.arena import load_arena, parse_arena
from robosim.control.lanes import LanesController
from robosim.discretise.pheromone import PheromoneConfig
from robosim.discretise.reward import RewardConfig
from robosim.envs.config import EnvConfig
from robosim.envs.vector import VectorEnv
from robosim.episodes.replay import begun, replay
from robosim.episodes.trajectory import Trajectory, load_trajectory, require_place
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
    ("text", "robots", "kind", "world"),
    [
        (load_arena("paper").text, 8, "cardinal", "physics"),
        (load_arena("three-wide").text, 6, "cardinal", "physics"),
        (VARIED, 4, "cardinal", "physics"),
        (load_arena("single-lane").text, 3, "wheels", "physics"),
        (load_arena("single-lane").text, 3, "wheels-9", "physics"),
        (load_arena("paper").text, 8, "cardinal", "grid"),
        (load_arena("single-lane").text, 3, "wheels", "grid"),
    ],
)
def test_a_saved_trajectory_runs_again_to_the_last_bit(tmp_path: Path, text, robots, kind, world) -> None:
    """The second episode of the second of three environments, from a file, in an environment of its own."""
    env = VectorEnv(
        parse_arena(text, "x"),
        robots=robots,
        num_envs=3,
        seed=5,
        actions=kind,
        world=world,
        episode_steps=400,
    )
    env.reset()
    observation = env.reset()
    controller, rng = LanesController(), np.random.default_rng(0)
    if kind == "cardinal":
        controller.reset(env)
    recorded, seen = [bits(env, 1)], [observation[1].tobytes()]
    for _ in range(200):
        actions = rng.integers(0, env.num_actions, (3, robots))
        if kind == "cardinal":
            actions = np.where(rng.random(actions.shape) < 0.2, actions, controller.act(env, observation))
        transition = env.step(actions)
        observation = transition.observation
        recorded.append(bits(env, 1))
        seen.append(observation[1].tobytes() + transition.reward[1].tobytes())
    env.trajectory(1).save(tmp_path / "run.npz")
    trajectory = load_trajectory(tmp_path / "run.npz")
    assert (trajectory.episode, trajectory.robots, trajectory.config.actions) == (1, robots, kind)
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


CONFIG = EnvConfig(
    arena=load_arena("paper").text,
    robots=2,
    pheromone=PheromoneConfig(decay=0.3, reinforcement=0.7, initial=0.25, diffusion=0.0, radius=3),
    reward=RewardConfig(
        kind="local", sharing="split", signed_distance=True, idle_cost=True, collision=-7.5, pickup_weight=0.9
    ),
    pellet_gradient=3.5,
)


def trajectory(**changes) -> Trajectory:
    fields = {
        "config": CONFIG,
        "seed": 2**64 - 1,
        "episode": 0,
        "chosen": np.array([[0, 4], [1, 2]], dtype=np.uint8),
        "policy": "lanes, by hand: \u00fcber 8",
    }
    return Trajectory(**(fields | changes))


def test_a_file_gives_back_what_was_saved(tmp_path: Path) -> None:
    saved = trajectory()
    saved.save(tmp_path / "a.npz")
    loaded = load_trajectory(tmp_path / "a.npz")
    assert loaded.chosen.dtype == np.uint8
    assert loaded.chosen.tolist() == saved.chosen.tolist()
    assert (loaded.config, loaded.seed, loaded.episode) == (CONFIG, 2**64 - 1, 0)
    assert loaded.policy == saved.policy
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]


def test_what_the_environment_was_set_to_is_in_its_trajectory_and_replay() -> None:
    pheromone = PheromoneConfig(decay=0.5, reinforcement=0.4, initial=0.1, diffusion=0.1, radius=1)
    env = VectorEnv(
        "paper",
        robots=3,
        seed=4,
        pheromone=pheromone,
        reward="local",
        sharing="split",
        signed_distance=True,
        idle_cost=True,
        pellet_gradient=6.0,
        stigmergy=False,
    )
    env.reset()
    rng = np.random.default_rng(1)
    seen = [(env.frame().reward.tobytes(), env.frame().pheromone.tobytes(), env.frame().pellets.tobytes())]
    for _ in range(30):
        env.step(rng.integers(0, 5, (1, 3)))
        frame = env.frame()
        seen.append((frame.reward.tobytes(), frame.pheromone.tobytes(), frame.pellets.tobytes()))
    trajectory = env.trajectory(policy="dice")
    assert trajectory.config == env.config
    assert trajectory.config.pheromone == pheromone
    assert (trajectory.config.reward.kind, trajectory.config.pellet_gradient) == ("local", 6.0)
    assert (trajectory.policy, env.trajectory().policy) == ("dice", "")
    again = [(f.reward.tobytes(), f.pheromone.tobytes(), f.pellets.tobytes()) for f in replay(trajectory)]
    assert again == seen


@pytest.mark.parametrize(
    ("policy", "shown"),
    [("a\nb", r"'a\nb'"), ("\x1b[2J", r"'\x1b[2J'"), ("x" * 4097, "a text of 4097 characters")],
)
def test_a_policy_of_more_than_a_printable_line_is_not_written(tmp_path: Path, policy, shown) -> None:
    with pytest.raises(InputError) as caught:
        trajectory(policy=policy).save(tmp_path / "a.npz")
    assert str(caught.value) == (
        f"{tmp_path / 'a.npz'}: policy is {shown}, but must be one line of at most 4096 printable characters."
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("run.rrd", "cannot be written: the name of a trajectory's file must end in .npz."),
        ("run", "cannot be written: the name of a trajectory's file must end in .npz."),
        ("nowhere/run.npz", "cannot be written: No such file or directory."),
        ("folder.npz", "cannot be written: it is a folder; give the name of a file."),
    ],
)
def test_a_place_that_cannot_be_written_is_one_sentence(tmp_path: Path, name, sentence) -> None:
    (tmp_path / "folder.npz").mkdir()
    for attempt in (require_place, trajectory().save):
        with pytest.raises(InputError) as caught:
            attempt(tmp_path / name)
        assert str(caught.value) == f"{tmp_path / name}: {sentence}"
    assert [path.name for path in tmp_path.iterdir()] == ["folder.npz"]


def test_what_cannot_be_run_again_is_one_sentence() -> None:
    with pytest.raises(InputError, match="^trajectory: it holds no decisions.$"):
        list(replay(trajectory(chosen=np.zeros((0, 2), dtype=np.uint8))))
    with pytest.raises(InputError, match="^trajectory: not a TOML file"):
        list(replay(trajectory(config=CONFIG.changed(arena="="))))
    many = trajectory(config=CONFIG.changed(robots=99), chosen=np.zeros((1, 99), dtype=np.uint8))
    with pytest.raises(
        InputError, match="^trajectory: robots is 99, but must be a whole number from 1 to 35"
    ):
        list(replay(many))
    # A stranger's file must not name a file of this machine: its arena is a text, never a path.
    with pytest.raises(InputError, match="^trajectory: not a TOML file"):
        list(replay(trajectory(config=CONFIG.changed(arena="arenas/paper.toml"))))
    with pytest.raises(InputError, match=r"^run\.npz: it holds no decisions.$"):
        list(replay(trajectory(chosen=np.zeros((0, 2), dtype=np.uint8)), "run.npz"))


def text(characters: bytes) -> np.ndarray:
    return np.frombuffer(characters, dtype=np.uint8)


def written(path: Path, **changes) -> Path:
    fields = {
        "format": np.int64(4),
        "config": text(b'{"robots": 2, "arena": "text"}'),
        "seed": np.uint64(3),
        "episode": np.int64(0),
        "chosen": np.zeros((2, 2), dtype=np.uint8),
        "policy": text(b"lanes"),
    } | changes
    with path.open("wb") as file:
        np.savez(file, **{name: value for name, value in fields.items() if value is not None})
    return path


WHOLE = "but must be one whole number from 0."
BYTES = "but must be bytes [decisions, robots] from 0 to 4."
LINE = "but must be one line of at most 4096 printable characters."


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"format": None}, "is no trajectory; it lacks format."),
        ({"seed": None}, "is no trajectory; it lacks seed."),
        ({"seed": None, "policy": None}, "is no trajectory; it lacks seed, policy."),
        ({"format": np.int64(9)}, "format is 9, but must be 4."),
        ({"format": np.int64(0)}, "format is 0, but must be 4."),
        ({"format": np.float64(1)}, f"format is 1.0, {WHOLE}"),
        ({"format": text(b"2")}, f"format is uint8 [1], {WHOLE}"),
        ({"seed": np.int64(-1)}, f"seed is -1, {WHOLE}"),
        ({"episode": np.zeros(2, dtype=np.int64)}, f"episode is int64 [2], {WHOLE}"),
        ({"chosen": np.full((2, 2), 5, dtype=np.uint8)}, f"chosen is 5, {BYTES}"),
        (
            {"config": text(b'{"actions": "wheels-9"}'), "chosen": np.full((2, 4), 9, dtype=np.uint8)},
            "chosen is 9, but must be bytes [decisions, robots] from 0 to 8.",
        ),
        ({"chosen": np.zeros((2, 2), dtype=np.int64)}, f"chosen is int64 [2, 2], {BYTES}"),
        ({"chosen": np.zeros(2, dtype=np.uint8)}, f"chosen is uint8 [2], {BYTES}"),
        ({"chosen": np.zeros((2, 0), dtype=np.uint8)}, f"chosen is uint8 [2, 0], {BYTES}"),
        (
            {"chosen": np.zeros((2, 3), dtype=np.uint8)},
            "chosen is uint8 [2, 3], but must be bytes [decisions, 2].",
        ),
        ({"chosen": np.array([["x"]])}, f"chosen is str32 [1, 1], {BYTES}"),
        ({"config": np.array([1.0])}, "config is float64 [1], but must be the bytes of a text."),
        ({"config": text(b"a\xff\xfe")}, "config is byte 1, but must be UTF-8 text."),
        ({"config": text(b"[2]")}, "config is [2], but must be a table."),
        (
            {"config": text(b"[" * 10_000_001)},
            "config is uint8 [10000001], but must be at most 10000000 bytes of a text.",
        ),
        ({"config": text(b"robots = 2")}, "config is not JSON (Expecting value: line 1 column 1 (char 0))."),
        (
            {"config": text(b'{"robots": 0}')},
            "config: robots is 0, but must be a whole number from 1 to 1000.",
        ),
        (
            {"config": text(b'{"world": "heaven"}')},
            'config: world is "heaven", but must be "physics" or "grid".',
        ),
        (
            {"config": text(b'{"pheromone": {"decay": 0}}')},
            "config: pheromone.decay is 0, but must be a number from 1e-06 to 1.",
        ),
        (
            {"config": text(b'{"pellet_gradient": NaN}')},
            "config is not JSON (NaN is no JSON).",
        ),
        ({"policy": np.array("lanes")}, "policy is str160 [], but must be the bytes of a text."),
        ({"policy": text(b"\xff")}, "policy is byte 0, but must be UTF-8 text."),
        ({"policy": text(b"a\x07")}, rf"policy is 'a\x07', {LINE}"),
        ({"policy": text(b"x" * 5000)}, f"policy is a text of 5000 characters, {LINE}"),
    ],
)
def test_a_wrong_file_is_one_sentence(tmp_path: Path, changes, sentence) -> None:
    path = written(tmp_path / "wrong.npz", **changes)
    with pytest.raises(InputError) as caught:
        load_trajectory(path)
    assert str(caught.value) == f"{path}: {sentence}"


def test_no_file_and_a_file_of_something_else_are_one_sentence_and_run_no_code(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.npz: there is no such trajectory\.$"):
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


def test_a_field_with_a_broken_head_is_one_sentence(tmp_path: Path) -> None:
    path = written(tmp_path / "head.npz")
    path.write_bytes(path.read_bytes().replace(b"{'descr'", b"_'descr'"))
    with pytest.raises(InputError, match=r"head\.npz: is no trajectory \("):
        load_trajectory(path)


@pytest.fixture(scope="module")
def saved(tmp_path_factory) -> tuple[Path, Path]:
    """As it is saved, and not compressed, so that damage reaches numpy's reader."""
    folder = tmp_path_factory.mktemp("saved")
    trajectory().save(folder / "whole.npz")
    return folder / "whole.npz", written(folder / "stored.npz")


@settings(max_examples=200)
@given(
    st.lists(st.tuples(st.floats(0.0, 0.9999), st.integers(0, 255)), min_size=1, max_size=3),
    st.floats(0.0, 5.0),
    st.booleans(),
)
def test_a_damaged_file_is_a_trajectory_or_one_sentence(saved, damage, length, stored) -> None:
    content = bytearray(saved[stored].read_bytes())
    for place, value in damage:
        content[int(place * len(content))] = value
    if length < 1.0:
        del content[int(length * len(content)) :]
    path = saved[0].with_name("damaged.npz")
    path.write_bytes(content)
    try:
        load_trajectory(path)
    except InputError as refusal:
        assert str(refusal).startswith(f"{path}: ")
        assert str(refusal).isprintable()


SCALARS = st.one_of(
    st.integers(-2, 3).map(np.int64),
    st.integers(0, 2**64 - 1).map(np.uint64),
    st.floats(width=32).map(np.float32),
    st.booleans().map(np.bool_),
    st.text(max_size=3).map(np.array),
)
ARRAYS = arrays(
    st.sampled_from([np.uint8, np.int64, np.float64, np.complex64, "S3", "datetime64[s]", [("a", np.uint8)]]),
    array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=6),
)


@settings(max_examples=200)
@given(
    st.dictionaries(
        st.sampled_from(["format", "config", "seed", "episode", "chosen", "policy", "more"]),
        st.one_of(
            st.none(),
            SCALARS,
            ARRAYS,
            st.text(max_size=8).map(lambda characters: text(characters.encode())),
            st.lists(st.floats(), min_size=5, max_size=5).map(np.array),
        ),
        min_size=1,
        max_size=3,
    )
)
def test_fields_of_any_kind_are_a_trajectory_or_one_sentence(tmp_path_factory, changes) -> None:
    """And what is read can be written and read again."""
    path = tmp_path_factory.getbasetemp() / "any.npz"
    written(path, **changes)
    try:
        found = load_trajectory(path)
    except InputError as refusal:
        sentence = str(refusal)
        assert sentence.startswith(f"{path}: ")
        assert sentence.isprintable()
        return
    found.save(path)
    again = load_trajectory(path)
    assert again.chosen.tolist() == found.chosen.tolist()
    assert (again.config, again.seed, again.episode, again.policy) == (
        found.config, found.seed, found.episode, found.policy,
    )  # fmt: skip


def test_a_file_that_claims_to_unpack_to_more_than_fits_is_refused_unread(tmp_path: Path) -> None:
    path = written(tmp_path / "bomb.npz")
    content = bytearray(path.read_bytes())
    entry = content.index(b"PK\x01\x02")
    content[entry + 24 : entry + 28] = (2**31 - 1).to_bytes(4, "little")
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"format takes 2147483647 bytes, but may take at most 200\.$"):
        load_trajectory(path)


@pytest.mark.parametrize(
    ("field", "size", "most"), [("policy", 20_000, 16_584), ("config", 2**24, 10_000_200), ("seed", 201, 200)]
)
def test_fields_that_unpack_to_more_than_they_can_hold_are_not_unpacked(tmp_path, field, size, most) -> None:
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(f"{field}.npy", bytes(size))
    sentence = f"{path}: is no trajectory; {field} takes {size} bytes, but may take at most {most}."
    with pytest.raises(InputError) as caught:
        load_trajectory(path)
    assert str(caught.value) == sentence


def test_a_pipe_in_the_place_of_a_trajectory_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "run.npz")
    with pytest.raises(InputError, match=r"run\.npz: not a regular file, as a trajectory must be\.$"):
        load_trajectory(tmp_path / "run.npz")


def test_a_trajectory_is_what_was_saved(tmp_path: Path) -> None:
    saved = trajectory()
    saved.save(tmp_path / "run.npz")
    loaded = load_trajectory(tmp_path / "run.npz")
    assert loaded == load_trajectory(tmp_path / "run.npz") == saved
    assert loaded != trajectory(chosen=loaded.chosen[:-1])
