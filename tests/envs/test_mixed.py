"""Teams of several sizes in several arenas as one batch: the same as each environment by itself."""

from typing import Any

import numpy as np
import pytest

from robosim.arena import load_arena
from robosim.arena.random import random_arena
from robosim.envs.config import EnvConfig
from robosim.envs.mixed import MixedVectorEnv
from robosim.envs.variety import VarietyConfig
from robosim.envs.vector import Snapshot, Transition, VectorEnv
from robosim.errors import InputError

BASE = EnvConfig(episode_steps=12, pellet_gradient=8.0)
VARIETY = VarietyConfig(
    arenas=("paper", "s-bend"), random_arenas=3, arena_seed=40, team_sizes=(1, 3), envs_per_arena=2
)


def mixed(variety: VarietyConfig = VARIETY, num_envs: int = 8, seed: int = 5, **env: Any) -> MixedVectorEnv:
    return MixedVectorEnv(BASE.with_options(**env), variety, num_envs=num_envs, seed=seed)


def actions(env: MixedVectorEnv, rng: np.random.Generator) -> np.ndarray:
    return rng.integers(5, size=(env.num_envs, 1))


@pytest.mark.parametrize("world", ["physics", "grid"])
def test_each_environment_is_as_it_would_be_alone(world: str) -> None:
    env = mixed(world=world)
    seen = env.reset()
    alone = [
        [
            VectorEnv(group.config, seed=[group.seeds[place]], autoreset=False)
            for place in range(group.num_envs)
        ]
        for group in env.groups
    ]
    single = [one for group in alone for one in group]
    own = np.concatenate([one.reset()[0] for one in single])
    rng = np.random.default_rng(0)
    for _ in range(BASE.episode_steps):
        assert np.array_equal(seen[:, 0], own)
        chosen = actions(env, rng)
        transition, first, parts = env.step(chosen), 0, []
        for one in single:
            parts.append(one.step(chosen[first : first + one.robots, 0][None]))
            first += one.robots
        own = np.concatenate([part.final_observation[0] for part in parts])
        for name in ("reward", "final_observation", "final_delivered", "collided", "blocked"):
            ours = getattr(transition, name)
            assert np.array_equal(ours[:, 0], np.concatenate([getattr(part, name)[0] for part in parts]))
        for name in ("terminated", "truncated"):
            expected = np.concatenate([getattr(part, name).repeat(part.reward.shape[1]) for part in parts])
            assert np.array_equal(getattr(transition, name), expected)
        seen = transition.observation
    assert transition.truncated.all()
    assert not np.array_equal(seen, transition.final_observation)


def test_groups_have_the_sizes_and_arenas_that_were_asked_for() -> None:
    env = mixed(num_envs=16)
    env.reset()
    assert (env.joint_decisions, env.num_envs, env.robots) == (16, 2 * 8 * 2, 1)
    assert sorted(group.robots for group in env.groups) == [1] * 4 + [3] * 4
    assert env.reset().shape == (32, 1, env.layout.size)
    listed = {VectorEnv(name).arena.text for name in VARIETY.arenas}
    drawn = {random_arena(seed) for seed in (40, 41, 42)}
    texts = [group.arena.text for group in env.groups]
    assert set(texts) <= listed | drawn
    assert sum(text in listed for text in texts) == 4


@pytest.mark.parametrize(("redraw", "changes"), [(0, []), (1, [1, 2, 3, 4]), (2, [2, 4])])
def test_arenas_are_drawn_anew_after_so_many_episodes(redraw: int, changes: list[int]) -> None:
    env = mixed(VARIETY.changed(redraw=redraw, random_arenas=1000))
    env.reset()
    before, found = [group.arena.text for group in env.groups], []
    for episode in range(1, 5):
        env.reset()
        assert env.episode == episode
        now = [group.arena.text for group in env.groups]
        found += [episode] if now != before else []
        before = now
    assert found == changes


def test_equal_seeds_give_equal_batches_and_episodes_differ() -> None:
    one, same, other = mixed(), mixed(), mixed(seed=6)
    first = one.reset()
    assert np.array_equal(first, same.reset())
    assert not np.array_equal(first, other.reset())
    never = VARIETY.changed(redraw=0)
    again = mixed(never)
    assert not np.array_equal(again.reset(), again.reset())


@pytest.mark.parametrize("decisions", [5, 12, 17])
def test_a_restored_moment_goes_on_in_the_same_bits(decisions: int) -> None:
    whole, rng = mixed(), np.random.default_rng(1)
    whole.reset()
    for _ in range(decisions):
        seen = whole.step(actions(whole, rng)).observation
    snapshot = whole.snapshot()
    assert snapshot.actions.shape == (decisions % BASE.episode_steps, whole.num_envs, 1)
    other = mixed()
    assert np.array_equal(other.restore(snapshot), seen)
    for _ in range(15):
        chosen = actions(whole, rng)
        for ours, theirs in zip(whole.step(chosen), other.step(chosen), strict=True):
            assert ours.dtype == theirs.dtype
            assert np.array_equal(ours, theirs)


def test_a_transition_has_what_that_of_a_plain_batch_has() -> None:
    env, plain = mixed(), VectorEnv("paper", robots=1, num_envs=2)
    env.reset()
    plain.reset()
    ours = env.step(np.zeros((env.num_envs, 1), int))
    theirs = plain.step(np.zeros((2, 1), int))
    for name in Transition._fields:
        one, other = getattr(ours, name), getattr(theirs, name)
        assert (one.dtype, one.shape) == (other.dtype, (env.num_envs, *other.shape[1:]))


def test_what_does_not_fit_is_one_sentence(tmp_path: Any) -> None:
    narrow = tmp_path / "narrow.toml"
    narrow.write_text(
        'name = "narrow"\ncell_size = 0.15\nmap = """\n######\n#HTSS#\n#HTSS#\n######\n"""\n'
        "[pellets]\ncount = 5\n"
    )
    for variety, num_envs, sentence in (
        (
            VarietyConfig(arenas=("three-wide",)),
            8,
            (
                "arenas: cell_size of three-wide is 0.08, but must be 0.15, as in paper: one network is to "
                "drive in all of them."
            ),
        ),
        (
            VarietyConfig(arenas=(str(narrow),), team_sizes=(1, 8)),
            8,
            "arenas: narrow has room for 2 robots, but must have room for 8, as team_sizes says.",
        ),
        (
            VarietyConfig(random_arenas=1, arena_seed=8),
            8,
            (
                "arenas: cell_size of random-8 is 0.15, but must be 0.2, as in robotarium: one network is to "
                "drive in all of them."
            ),
        ),
        (VARIETY, 7, "num_envs is 7, but must be a multiple of envs_per_arena, 2."),
    ):
        with pytest.raises(InputError) as caught:
            mixed(variety, num_envs, arena="robotarium" if "robotarium" in sentence else "paper")
        assert str(caught.value) == sentence
    env = mixed()
    with pytest.raises(InputError, match="call reset first"):
        env.step(np.zeros((env.num_envs, 1), int))
    env.reset()
    with pytest.raises(InputError, match=r"must be whole numbers from 0 to 4"):
        env.step(np.zeros((env.num_envs, 2), int))
    nothing = np.zeros((0, env.num_envs, 1), np.uint8)
    for seeds in ((1, 2, 3), tuple(seed + 1 for seed in env.seeds)):
        with pytest.raises(InputError, match="snapshot: it is of other seeds than this batch, and seeds say"):
            env.restore(Snapshot(seeds, 0, nothing))
    with pytest.raises(InputError, match="^snapshot is 3, but must be what `snapshot` returned"):
        env.restore(3)  # type: ignore[arg-type]


@pytest.mark.parametrize(("share", "random"), [(0.0, 0), (0.01, 1), (0.5, 4), (0.99, 7), (1.0, 8)])
def test_a_small_share_of_random_arenas_is_not_rounded_away(share: float, random: int) -> None:
    variety = VarietyConfig(arenas=("paper",), random_arenas=5, random_share=share)
    drawn = variety.draw(8, (1, 2), 0, lambda text: True)
    assert len(drawn) - drawn.count("paper") == random


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({}, "arenas is empty and random_arenas is 0, but one of them must be there."),
        (
            {"random_arenas": 1, "team_sizes": (33,)},
            "team_sizes holds 33, but must hold at most 32 with random arenas.",
        ),
        (
            {"random_arenas": 1, "team_sizes": ()},
            "team_sizes is [], but must be a list of 1 to 1000 whole numbers from 1 to 1000.",
        ),
        (
            {"random_arenas": 1, "redraw": -1},
            "redraw is -1, but must be a whole number from 0 to 1000000000.",
        ),
    ],
)
def test_a_wrong_variety_is_one_sentence(fields: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError) as caught:
        VarietyConfig(**fields)
    assert str(caught.value) == sentence


@pytest.mark.parametrize("fields", [{"world": "grid"}, {"keep_distance": 0.15}])
def test_random_arenas_without_room_for_the_largest_team_are_passed_over(fields: dict[str, Any]) -> None:
    variety = VarietyConfig(random_arenas=20, team_sizes=(24,), envs_per_arena=1)
    env = MixedVectorEnv(EnvConfig(episode_steps=1, **fields), variety, num_envs=2, seed=3)
    env.reset()
    drawn = set()
    for _ in range(6):
        drawn |= {group.arena.name for group in env.groups}
        env.step(np.zeros((48, 1), int))
    assert len(drawn) > 2
    small = [random_arena(seed) for seed in range(20) if env._room(load_arena(random_arena(seed))) < 24]
    assert small
    assert not {load_arena(text).name for text in small} & drawn


def test_where_no_random_arena_has_room_it_is_said_before_anything_runs() -> None:
    variety = VarietyConfig(random_arenas=3, team_sizes=(32,), envs_per_arena=1)
    with pytest.raises(InputError) as caught:
        MixedVectorEnv(EnvConfig(keep_distance=0.5), variety, num_envs=1)
    assert str(caught.value) == (
        "random_arenas: none of 100 in turn has room for 32 robots, as team_sizes says, in this world and at "
        "this keep_distance."
    )
