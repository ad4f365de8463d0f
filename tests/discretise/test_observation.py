from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from robosim.arena import load_arena, parse_arena
from robosim.discretise.cells import NEIGHBOURS
from robosim.discretise.observation import (
    ENCODINGS,
    Encoding,
    ObservationLayout,
    blocked_moves,
    gain_columns,
)
from robosim.discretise.pheromone import CHANNELS, PheromoneConfig
from robosim.envs.vector import VectorEnv
from robosim.robot.drivers import ACTION_KINDS, ActionKind
from tests.discretise.recorded import RUNS, TINY, recorded

PAPERS_EIGHT = (
    "mode", "x", "y", "heading", "previous action", "collisions", "distance to home", "distance to source"
)  # fmt: skip


def test_the_paper_encoding_is_the_eight_numbers_and_nothing_else() -> None:
    layout = ObservationLayout("paper", stigmergy=False, actions="cardinal", radius=2)
    assert layout.names == PAPERS_EIGHT
    assert layout.size == 8


def test_stigmergy_adds_the_patch_from_the_north_west_and_the_density() -> None:
    for encoding in ENCODINGS:
        bare = ObservationLayout(encoding, stigmergy=False, actions="cardinal", radius=1)
        full = ObservationLayout(encoding, stigmergy=True, actions="cardinal", radius=1)
        added = full.names[bare.size :]
        assert full.names[: bare.size] == bare.names
        assert added[:9] == (
            "occupancy (-1, +1)", "occupancy (+0, +1)", "occupancy (+1, +1)",
            "occupancy (-1, +0)", "occupancy (+0, +0)", "occupancy (+1, +0)",
            "occupancy (-1, -1)", "occupancy (+0, -1)", "occupancy (+1, -1)",
        )  # fmt: skip
        assert [name.split(" ")[0] for name in added[:36:9]] == ["occupancy", "mode", "laden", "action"]
        assert added[36:] == ("tunnel density",)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("actions", ACTION_KINDS)
@pytest.mark.parametrize("stigmergy", [True, False])
def test_names_are_unique_and_as_many_as_numbers(
    encoding: Encoding, actions: ActionKind, stigmergy: bool
) -> None:
    env = VectorEnv("paper", robots=2, encoding=encoding, actions=actions, stigmergy=stigmergy)
    layout, observation = env.layout, env.reset()
    assert len(set(layout.names)) == layout.size == observation.shape[-1]
    assert layout.low.shape == layout.high.shape == (layout.size,)
    assert observation.dtype == layout.low.dtype == layout.high.dtype == np.float32
    assert any("patch" in name or "occupancy" in name for name in layout.names) == stigmergy


@pytest.mark.parametrize("name", RUNS)
def test_every_number_stays_within_its_bounds(name: str) -> None:
    run = recorded(name)
    for moment in [run.start, *run.moments]:
        assert moment.observation.dtype == np.float32
        assert (moment.observation >= run.layout.low).all()
        assert (moment.observation <= run.layout.high).all()


@pytest.mark.parametrize("runs", [["paper", "weak grip", "three-wide"], ["single-lane"]])
def test_every_number_changes(runs: list[str]) -> None:
    """A position that nothing writes to, or always the same, would stay as it is."""
    layout = recorded(runs[0]).layout
    moments = [moment for name in runs for moment in recorded(name).moments]
    seen = np.concatenate([moment.observation.reshape(-1, layout.size) for moment in moments])
    constant = [layout.names[i] for i in np.flatnonzero(seen.min(axis=0) == seen.max(axis=0))]
    # A laden robot may never have been in one of the patch's corners.
    assert [name for name in constant if not name.startswith("laden (")] == []


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(
    ("options", "left_out"),
    [
        ({"stigmergy": False}, (*CHANNELS, "tunnel density")),
        ({"pheromone_seen": "patch"}, ("tunnel density",)),
        ({"pheromone_seen": "density"}, CHANNELS),
        ({"neighbours": False}, ("free ",)),
        ({"neighbours": False, "pheromone_seen": "density"}, ("free ", *CHANNELS)),
    ],
)
def test_what_is_not_seen_leaves_everything_else_the_same(
    encoding: Encoding, options: dict[str, Any], left_out: tuple[str, ...]
) -> None:
    whole = VectorEnv("paper", robots=4, encoding=encoding)
    part = VectorEnv("paper", robots=4, encoding=encoding, **options)
    starts = tuple(f"{name} (" if name in CHANNELS else name for name in left_out)
    kept = [place for place, name in enumerate(whole.layout.names) if not name.startswith(starts)]
    assert part.layout.names == tuple(whole.layout.names[place] for place in kept)
    assert_array_equal(whole.reset(1)[..., kept], part.reset(1))
    rng = np.random.default_rng(0)
    for _ in range(30):
        actions = rng.integers(0, 5, (1, 4))
        all_of_it, some = whole.step(actions), part.step(actions)
        assert_array_equal(all_of_it.observation[..., kept], some.observation)
        assert_array_equal(all_of_it.reward, some.reward)


def test_a_field_of_view_larger_than_the_map_reads_nothing_outside_of_it() -> None:
    arena = parse_arena(TINY, "tiny.toml")
    env = VectorEnv(arena, robots=2, pheromone=PheromoneConfig(radius=30, initial=1.0, diffusion=0.1))
    observation = env.reset()
    side = 61
    own = env.layout.size - 4 * side * side - 1
    rng = np.random.default_rng(0)
    for step in range(10):
        if step:
            observation = env.step(rng.integers(0, 5, (1, 2))).observation
        for robot in range(2):
            patch = observation[0, robot, own:-1].reshape(4, side, side)
            column, row = (env.world.state.pose[0, robot, :2] / arena.cell_size).astype(int)
            # The patch's first row is the north; the arena's first is the south.
            south_first = patch[:, ::-1]
            inside = south_first[:, 30 - row :, 30 - column :][:, : arena.rows, : arena.columns]
            assert_array_equal(inside[0] > 0.0, arena.zones != 0)
            assert np.count_nonzero(patch) == np.count_nonzero(inside)


def test_walls_read_as_nothing_and_occupancy_is_relative_to_saturation() -> None:
    """One robot that stands still for long: its own cell is full, the others' share falls with distance."""
    config = PheromoneConfig(decay=0.1, reinforcement=0.3, diffusion=0.0, radius=1)
    env = VectorEnv("paper", robots=1, pheromone=config)
    env.reset(0)
    for _ in range(400):
        observation = env.step([[4]]).observation
    named = dict(zip(env.layout.names, observation[0, 0].tolist(), strict=True))
    assert named["occupancy (+0, +0)"] == pytest.approx(1.0)
    assert named["mode (+0, +0)"] == pytest.approx(6 / 7)
    assert named["action (+0, +0)"] == pytest.approx(1.0)
    assert named["laden (+0, +0)"] == 0.0
    rest = [value for name, value in named.items() if name.startswith("occupancy") and "+0, +0" not in name]
    assert rest == [0.0] * 8


def test_density_is_what_is_in_the_tunnel_over_its_length_and_at_most_one() -> None:
    """Started in the tunnel, robots count from the first observation on, more than its length as 1."""
    poses = [[1.3 + 0.13 * (index // 2), 0.51 + 0.18 * (index % 2), 0.0] for index in range(14)]
    crowd = parse_arena(load_arena("paper").text + f"\n[start]\nposes = {poses}\n", "crowd.toml")
    for robots, density in ((1, 1 / 11), (5, 5 / 11), (11, 1.0), (14, 1.0)):
        env = VectorEnv(crowd, robots=robots, encoding="paper")
        observation = env.reset()
        assert observation[0, :, -1] == pytest.approx(density)
        assert env.frame().density == pytest.approx(robots / 11)


@pytest.mark.parametrize("arena", ["paper", "single-lane", "s-bend"])
def test_blocked_moves_are_walls_and_what_leads_away_from_both_goals(arena: str) -> None:
    env = VectorEnv(arena, robots=3, num_envs=2, seed=1)
    columns = gain_columns(env.layout.names, "cardinal")
    assert columns is not None
    observation = env.reset()
    rng, walls, free = np.random.default_rng(0), 0, 0
    read = load_arena(arena)
    centre = read.cell_size * np.float64(0.5)
    for _ in range(400):
        closed = blocked_moves(observation, columns)
        for place in np.ndindex(2, 3):
            column, row = (env.world.state.pose[place][:2] / read.cell_size).astype(int)
            here = read.distances.sample(np.array([column, row]) * read.cell_size + centre)
            for move, (across, up) in enumerate(NEIGHBOURS[:4]):
                if read.zones[row + up, column + across] == 0:
                    assert closed[(*place, move)]
                    walls += 1
                    continue
                there = read.distances.sample(np.array([column + across, row + up]) * read.cell_size + centre)
                lost = (there - here) / read.cell_size
                assert closed[(*place, move)] == (lost >= 1.0).all()
                free += 1
        observation = env.step(rng.integers(5, size=(2, 3))).observation
    assert min(walls, free) > 100


@pytest.mark.parametrize("actions", ["wheels", "wheels-9"])
def test_forward_and_back_are_blocked_as_moves_are(actions: ActionKind) -> None:
    """Forward and back are, the robot's own ahead and behind; turning never is."""
    env = VectorEnv("paper", robots=3, num_envs=2, seed=1, actions=actions)
    columns = gain_columns(env.layout.names, actions)
    assert columns is not None
    observation = env.reset()
    rng, walls, free, read = np.random.default_rng(0), 0, 0, load_arena("paper")
    for _ in range(400):
        closed = blocked_moves(observation, columns)
        assert closed.shape == (2, 3, 2)
        for place in np.ndindex(2, 3):
            pose = env.world.state.pose[place]
            here = read.distances.sample(pose[:2])
            for move, sign in enumerate((1.0, -1.0)):
                heading = np.array([np.cos(pose[2]), np.sin(pose[2])])
                point = pose[:2] + sign * read.cell_size * heading
                column, row = np.floor(point / read.cell_size).astype(int)
                if read.zones[row, column] == 0:
                    assert closed[(*place, move)]
                    walls += 1
                else:
                    lost = (read.distances.sample(point) - here) / read.cell_size
                    if (np.abs(lost - 1.0) > 1e-6).all():
                        assert closed[(*place, move)] == (lost > 1.0).all()
                    free += 1
        observation = env.step(rng.integers(env.num_actions, size=(2, 3))).observation
    assert min(walls, free) > 100


def test_the_expanded_encoding_alone_tells_ways() -> None:
    for actions in ACTION_KINDS:
        assert gain_columns(ObservationLayout("paper", True, actions, 2).names, actions) is None
        names = ObservationLayout("expanded", True, actions, 2).names
        columns = gain_columns(names, actions)
        assert columns is not None
        side, moves = ("N", 4) if actions == "cardinal" else ("ahead", 2)
        assert columns.moves == moves
        assert [names[first] for first in columns[:2]] == [f"gain home {side}", f"gain source {side}"]
        # Those of the map's sides say nothing of driving, nor those of the robot's own of the map's sides.
        assert gain_columns(names, "wheels" if actions == "cardinal" else "cardinal") is None
