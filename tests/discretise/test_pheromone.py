import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from robosim.arena import Arena, load_arena, parse_arena
from robosim.arena.model import Zone
from robosim.discretise.cells import Grid
from robosim.discretise.pheromone import CHANNELS, PheromoneConfig, PheromoneMap
from robosim.errors import InputError
from tests.discretise.plain import PlainMap
from tests.discretise.recorded import TINY

PAPER = load_arena("paper")
# A wall column cuts the floor on the right off: nobody gets there, but the map has cells there.
DIVIDED = parse_arena(
    TINY.replace("#HH..SS#\n#HH..SS#", "#HH..SS#..#\n#HH..SS#..#").replace("########", "###########"),
    "divided.toml",
)

SYMMETRIC = parse_arena(
    TINY.replace("#HH..SS#\n#HH..SS#", "#HH.##.SS#\n#HH.TT.SS#\n#HH.##.SS#").replace(
        "########", "##########"
    ),
    "symmetric.toml",
)


def make_map(config: PheromoneConfig, arena: Arena = PAPER, envs: int = 1) -> tuple[Grid, PheromoneMap]:
    grid = Grid(arena, max(config.radius, 1))
    pheromone = PheromoneMap(grid, envs, config, 5)
    pheromone.reset()
    return grid, pheromone


def visit(grid: Grid, pheromone: PheromoneMap, *cells: tuple[int, int], mode=0, laden=False, action=4):
    """One decision in one environment; cells are (column, row)."""
    flat = [(row + grid.margin) * grid.shape[1] + column + grid.margin for column, row in cells]
    shape = (1, len(cells))
    pheromone.update(
        np.array(flat, dtype=np.int64).reshape(shape),
        np.full(shape, mode, dtype=np.uint8),
        np.full(shape, laden),
        np.full(shape, action),
    )


def patch(grid: Grid, pheromone: PheromoneMap, column: int, row: int, radius: int) -> np.ndarray:
    """What a robot reads: [channels, rows from the north, columns]."""
    side = 2 * radius + 1
    out = np.empty((1, 1, pheromone.patch_size), dtype=np.float32)
    pheromone.read(np.array([[(row + grid.margin) * grid.shape[1] + column + grid.margin]]), out)
    return out.reshape(len(CHANNELS), side, side)


@given(
    seed=st.integers(0, 2**32 - 1),
    decay=st.floats(1e-6, 1.0),
    reinforcement=st.floats(1e-6, 1.0),
    initial=st.floats(0.0, 1.0),
    diffusion=st.floats(0.0, 0.2),
    radius=st.integers(0, 4),
)
def test_random_walks_leave_what_the_plain_reference_says(
    seed, decay, reinforcement, initial, diffusion, radius
) -> None:
    config = PheromoneConfig(
        decay=decay, reinforcement=reinforcement, initial=initial, diffusion=diffusion, radius=radius
    )
    rng = np.random.default_rng(seed)
    envs, robots = 2, 3
    grid, pheromone = make_map(config, envs=envs)
    plain = [PlainMap(PAPER.zones.tolist(), config) for _ in range(envs)]
    free = plain[0].free
    where = rng.integers(len(free), size=(envs, robots))
    for _ in range(12):
        # Often the same cell again, and often another robot's.
        where = np.where(rng.random(where.shape) < 0.5, where, rng.integers(len(free), size=where.shape))
        where[:, 1] = np.where(rng.random(envs) < 0.3, where[:, 0], where[:, 1])
        mode = rng.integers(0, 7, where.shape).astype(np.uint8)
        laden = rng.random(where.shape) < 0.5
        action = rng.integers(0, 5, where.shape)
        cells = [[free[one] for one in row] for row in where.tolist()]
        flat = np.array(
            [[(y + grid.margin) * grid.shape[1] + x + grid.margin for x, y in row] for row in cells]
        )
        pheromone.update(flat, mode, laden, action)
        out = np.empty((envs, robots, pheromone.patch_size), dtype=np.float32)
        pheromone.read(flat, out)
        for env in range(envs):
            visits = zip(
                cells[env], mode[env].tolist(), laden[env].tolist(), action[env].tolist(), strict=True
            )
            plain[env].update(list(visits))
            expected = np.zeros(PAPER.zones.shape)
            for (column, row), value in plain[env].occupancy.items():
                expected[row, column] = value
            assert_allclose(pheromone.occupancy[env], expected, rtol=1e-12, atol=1e-15)
            for robot, (column, row) in enumerate(cells[env]):
                seen = [
                    plain[env].read((column + dx, row + dy))[channel]
                    for channel in range(4)
                    for dy in range(radius, -radius - 1, -1)
                    for dx in range(-radius, radius + 1)
                ]
                assert_allclose(out[env, robot], seen, rtol=1e-6, atol=1e-7)


def test_a_cell_visited_without_end_tends_to_beta_over_alpha() -> None:
    config = PheromoneConfig(decay=0.05, reinforcement=0.2, diffusion=0.0)
    grid, pheromone = make_map(config)
    for step in range(1, 1001):
        visit(grid, pheromone, (5, 3))
        closed_form = 0.2 / 0.05 * (1.0 - 0.95**step)
        assert pheromone.occupancy[0, 3, 5] == pytest.approx(closed_form, rel=1e-12)
    assert pheromone.occupancy[0, 3, 5] == pytest.approx(config.saturation, rel=1e-12)
    assert np.count_nonzero(pheromone.occupancy) == 1
    assert patch(grid, pheromone, 5, 3, 2)[0, 2, 2] == 1.0


def test_the_map_begins_at_rho_0_on_free_cells_and_decays_from_there() -> None:
    config = PheromoneConfig(initial=0.7, diffusion=0.0)
    grid, pheromone = make_map(config)
    free = PAPER.zones != Zone.WALL
    assert_array_equal(pheromone.occupancy[0], np.where(free, 0.7, 0.0))
    for step in range(1, 6):
        visit(grid, pheromone)
        assert_allclose(pheromone.occupancy[0][free], 0.7 * 0.9**step, rtol=1e-14)


def test_reset_returns_every_environment_to_the_start() -> None:
    grid, pheromone = make_map(PheromoneConfig(initial=0.2), envs=2)
    cells = np.array([[grid.shape[1] * 5 + 6], [grid.shape[1] * 5 + 7]])
    pheromone.update(
        cells, np.array([[3], [3]], dtype=np.uint8), np.array([[True], [True]]), np.array([[1], [1]])
    )
    out = np.empty((2, 1, pheromone.patch_size), dtype=np.float32)
    pheromone.read(cells, out)
    assert out.reshape(2, 4, 25)[:, 1:].any(axis=(1, 2)).all()
    pheromone.reset()
    fresh = make_map(PheromoneConfig(initial=0.2), envs=2)[1]
    assert_array_equal(pheromone.occupancy, fresh.occupancy)
    pheromone.read(cells, out)
    assert not out.reshape(2, 4, 25)[:, 1:].any()


@given(st.floats(0.001, 0.2), st.integers(0, 2**32 - 1))
def test_diffusion_conserves_mass(diffusion: float, seed: int) -> None:
    """With nobody visiting, all that is lost is what decays, here a millionth."""
    config = PheromoneConfig(decay=1e-6, reinforcement=1.0, diffusion=diffusion)
    grid, pheromone = make_map(config)
    rng = np.random.default_rng(seed)
    rows, columns = np.nonzero(PAPER.zones != Zone.WALL)
    for _ in range(5):
        one = rng.integers(len(rows))
        visit(grid, pheromone, (int(columns[one]), int(rows[one])))
    mass = pheromone.occupancy.sum()
    for step in range(1, 101):
        visit(grid, pheromone)
        assert pheromone.occupancy.sum() == pytest.approx(mass * (1.0 - 1e-6) ** step, rel=1e-12)
        assert pheromone.occupancy.min() >= 0.0
    assert not pheromone.occupancy[0][PAPER.zones == Zone.WALL].any()


def test_diffusion_levels_out_and_never_overshoots() -> None:
    config = PheromoneConfig(decay=1e-6, reinforcement=1.0, diffusion=0.2)
    grid, pheromone = make_map(config, parse_arena(TINY, "tiny.toml"))
    visit(grid, pheromone, (1, 1))
    highest = pheromone.occupancy.max()
    for _ in range(400):
        visit(grid, pheromone)
        assert pheromone.occupancy.max() <= highest
        highest = pheromone.occupancy.max()
    cells = pheromone.occupancy[0, 1:3, 1:7]
    assert_allclose(cells, cells.mean(), rtol=1e-3)


def test_nothing_ever_passes_a_wall() -> None:
    """A wall column separates the map: not a trace gets to the other side."""
    grid, pheromone = make_map(PheromoneConfig(decay=1e-6, diffusion=0.2), DIVIDED)
    for _ in range(2000):
        visit(grid, pheromone, (6, 1), (6, 2))
    beyond = pheromone.occupancy[0, :, 8:]
    assert not beyond.any()
    assert pheromone.occupancy[0, 1:3, 1:7].all()
    assert not patch(grid, pheromone, 6, 1, 2)[:, :, 3:].any()


def test_mirrored_visits_leave_the_mirrored_map() -> None:
    config = PheromoneConfig(diffusion=0.15)
    rng = np.random.default_rng(0)
    maps = [make_map(config, SYMMETRIC) for _ in range(3)]
    free = SYMMETRIC.zones != Zone.WALL
    assert_array_equal(free, free[:, ::-1])
    assert_array_equal(free, free[::-1])
    last_column, last_row = SYMMETRIC.columns - 1, SYMMETRIC.rows - 1
    rows, columns = np.nonzero(free)
    for _ in range(200):
        one = rng.integers(len(rows))
        column, row = int(columns[one]), int(rows[one])
        visit(*maps[0], (column, row))
        visit(*maps[1], (last_column - column, row))
        visit(*maps[2], (column, last_row - row))
    here, across, below = (pheromone.occupancy[0] for _, pheromone in maps)
    assert_allclose(here, across[:, ::-1], rtol=1e-12)
    assert_allclose(here, below[::-1], rtol=1e-12)


def test_marks_are_the_last_visitors_and_fade_with_the_occupancy() -> None:
    config = PheromoneConfig(decay=0.1, reinforcement=0.1, diffusion=0.0, radius=1)
    grid, pheromone = make_map(config)
    visit(grid, pheromone, (5, 3), mode=6, laden=False, action=0)
    visit(grid, pheromone, (5, 3), mode=3, laden=True, action=2)
    strength = 0.1 * 0.9 + 0.1
    for _ in range(30):
        # Read from the cell to the east, so the marked one is in the middle of the west column.
        seen = patch(grid, pheromone, 6, 3, 1)
        assert seen[:, 1, 0].tolist() == pytest.approx(
            [strength, 4 / 7 * strength, strength, 3 / 5 * strength], rel=1e-6
        )
        seen[:, 1, 0] = 0.0
        assert not seen.any()
        visit(grid, pheromone)
        strength *= 0.9


def test_of_several_robots_in_a_cell_the_last_leaves_its_marks_and_the_visit_counts_once() -> None:
    grid, pheromone = make_map(PheromoneConfig(diffusion=0.0, radius=0))
    flat = np.full((1, 3), (3 + 1) * grid.shape[1] + 5 + 1)
    pheromone.update(
        flat, np.array([[0, 1, 5]], dtype=np.uint8), np.array([[True, True, False]]), np.array([[0, 1, 3]])
    )
    assert pheromone.occupancy[0, 3, 5] == 0.1
    assert patch(grid, pheromone, 5, 3, 0).ravel().tolist() == pytest.approx(
        [0.1, 6 / 7 * 0.1, 0.0, 4 / 5 * 0.1], rel=1e-6
    )


def test_every_mode_and_action_leaves_a_mark_of_its_own_that_is_not_nothing() -> None:
    grid, pheromone = make_map(PheromoneConfig(decay=1.0, reinforcement=1.0, diffusion=0.0, radius=0))
    seen = set()
    for mode in range(7):
        for action in range(5):
            visit(grid, pheromone, (5, 3), mode=mode, action=action)
            _, of_mode, _, of_action = patch(grid, pheromone, 5, 3, 0).ravel().tolist()
            assert 0.0 < of_mode <= 1.0
            assert 0.0 < of_action <= 1.0
            seen.add((of_mode, of_action))
    assert len(seen) == 35


@pytest.mark.parametrize(
    ("constants", "sentence"),
    [
        ({"decay": 0.0}, "decay is 0.0, but must be a number from 1e-06 to 1."),
        ({"decay": 1.5}, "decay is 1.5, but must be a number from 1e-06 to 1."),
        (
            {"decay": float("nan")},
            "decay is nan, but must be a number from 1e-06 to 1.",
        ),
        ({"decay": True}, "decay is true, but must be a number from 1e-06 to 1."),
        ({"decay": "0.1"}, 'decay is "0.1", but must be a number from 1e-06 to 1.'),
        (
            {"reinforcement": 0},
            "reinforcement is 0, but must be a number from 1e-06 to 1.",
        ),
        ({"initial": -0.1}, "initial is -0.1, but must be a number from 0 to 1."),
        ({"diffusion": 0.25}, "diffusion is 0.25, but must be a number from 0 to 0.2."),
        ({"radius": -1}, "radius is -1, but must be a whole number from 0 to 200."),
        ({"radius": 2.0}, "radius is 2.0, but must be a whole number from 0 to 200."),
        ({"radius": 201}, "radius is 201, but must be a whole number from 0 to 200."),
    ],
)
def test_constants_out_of_range_are_one_sentence(constants: dict[str, object], sentence: str) -> None:
    with pytest.raises(InputError) as refusal:
        PheromoneConfig(**constants)  # type: ignore[arg-type]
    assert str(refusal.value) == sentence
