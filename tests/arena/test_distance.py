import heapq
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.arena import arena_names, load_arena
from robosim.arena.distance import DistanceField, distance_field
from robosim.arena.geodesic import _fast_marching

FINE = 6


def field(text: str, cell_size: float = 1.0) -> DistanceField:
    grid = np.array([list(line) for line in reversed(text.split())])
    return distance_field(grid != "#", grid == "H", grid == "S", cell_size)


def by_many_neighbours(text: str, zone: str) -> dict[tuple[int, int], float]:
    """Distances from fine nodes to a zone by Dijkstra over all steps up to 7 nodes long."""
    grid = np.array([list(line) for line in reversed(text.split())])
    rows, columns = grid.shape

    def cells_at(x: float, y: float) -> list[str]:
        near = {(math.floor(y + b), math.floor(x + a)) for a in (-1e-6, 1e-6) for b in (-1e-6, 1e-6)}
        return [grid[r, c] for r, c in near if 0 <= r < rows and 0 <= c < columns]

    def pinched(i: int, j: int) -> bool:
        if i % FINE or j % FINE or not (0 < i < columns * FINE and 0 < j < rows * FINE):
            return False
        (a, b), (c, d) = (grid[j // FINE - 1 : j // FINE + 1, i // FINE - 1 : i // FINE + 1] == "#").tolist()
        return a == d and b == c and a != b

    nodes = {
        (i, j): cells_at(i / FINE, j / FINE)
        for i in range(columns * FINE + 1)
        for j in range(rows * FINE + 1)
    }
    nodes = {node: cells for node, cells in nodes.items() if set(cells) - {"#"} and not pinched(*node)}

    def crossings(at: int, step: int) -> list[float]:
        passed = range(min(at, at + step) + 1, max(at, at + step))
        return [(line - at) / step for line in passed if line % FINE == 0]

    steps = [
        (a, b) for a in range(-7, 8) for b in range(-7, 8) if math.gcd(a, b) == 1 and a * a + b * b <= 49
    ]
    best = {node: 0.0 if zone in cells else math.inf for node, cells in nodes.items()}
    heap = [(0.0, node) for node, length in best.items() if length == 0.0]
    while heap:
        length, (i, j) = heapq.heappop(heap)
        if length > best[i, j]:
            continue
        for a, b in steps:
            end = (i + a, j + b)
            longer = length + math.hypot(a, b) / FINE
            if end in best and longer < best[end] - 1e-12:
                cuts = sorted({0.0, 1.0, *crossings(i, a), *crossings(j, b)})
                middles = [(s + t) / 2 for s, t in pairwise(cuts)]
                line = [((i + a * t) / FINE, (j + b * t) / FINE) for t in middles]
                if all(set(cells_at(x, y)) - {"#"} for x, y in line):
                    best[end] = longer
                    heapq.heappush(heap, (longer, end))
    return best


def test_straight_is_straight() -> None:
    distances = field("######## #HH...S# ########", cell_size=0.5).sample(
        np.array([[2.25, 0.75], [0.75, 0.75]])
    )
    assert distances == pytest.approx(np.array([[0.75, 0.75], [0.0, 2.25]]))


def test_the_path_bends_at_the_corner() -> None:
    distances = field("##### #..S# #.#### #H### #####".replace("#.####", "#.###"))
    start = np.array([1.5, 1.5])
    expected = math.hypot(0.5, 1.5) + 1.0
    assert distances.sample(start)[1] == pytest.approx(expected)
    # From the outer corner of the bend, both are in sight.
    assert distances.sample(np.array([1.5, 3.5])) == pytest.approx([1.5, 1.5])


def test_the_path_slides_along_walls_and_bends_thrice() -> None:
    distances = field("####### #.....# #.###.# #H#S..# #######")
    assert distances.sample(np.array([1.5, 2.0]))[1] == pytest.approx(math.hypot(0.5, 1.0) + 3.0 + 1.0 + 1.0)


def test_no_path_leads_between_walls_that_touch_at_a_corner() -> None:
    distances = field("###### #H#..# #..#.# ##...# ##.S.# ######".replace("##...#", "#....#"))
    # From the cell right of the pinch (3, 4), the straight line to the home would lead through it.
    assert distances.sample(np.array([3.5, 4.5]))[0] > 3.0


MAPS = [
    "########## #HH..#...# #HH.....S# #..#.#.#S# ##########",
    "######### #H..#..S# #.#...#.# #.##.##.# #.......# #########",
    "####### #H#...# #..#..# #.....# #.##.S# #######",
]


@pytest.mark.parametrize("text", MAPS)
@pytest.mark.parametrize(("zone", "index"), [("H", 0), ("S", 1)])
def test_equals_dense_dijkstra(text: str, zone: str, index: int) -> None:
    slow = by_many_neighbours(text, zone)
    reached = [(node, length) for node, length in slow.items() if math.isfinite(length)]
    nodes = np.array([node for node, _ in reached]) / FINE
    lengths = np.array([length for _, length in reached])
    # Between raster nodes the bilinear reading adds a little near corners.
    exact = field(text).sample(nodes)[:, index]
    assert (exact <= lengths + 0.03).all()
    assert (exact >= 0.985 * lengths - 0.03).all()


def test_fast_marching_stays_near_the_exact_length() -> None:
    rows = ["#" * 62, *["#" + "." * 60 + "#"] * 40, "#" * 62]
    grid = np.array([list(row) for row in rows])
    grid[10:41, 20] = "#"
    grid[1:32, 40] = "#"
    zone = np.zeros(grid.shape, dtype=bool)
    zone[1:5, 1:5] = True
    exact = distance_field(grid != "#", zone, zone, 1.0)
    fast = _fast_marching(grid != "#", zone)
    row, column = np.nonzero((grid != "#") & ~zone)
    slow = exact.sample(np.stack((column + 0.5, row + 0.5), axis=-1))[:, 0]
    assert np.abs(fast[row, column] - slow).max() < 0.06 * slow.max()


@pytest.mark.parametrize("name", arena_names())
def test_zero_in_the_zone_and_a_step_changes_no_more_than_its_length(name: str) -> None:
    arena = load_arena(name)
    rng = np.random.default_rng(1)
    points = rng.uniform(0.0, arena.size, (4000, 2))
    steps = points + rng.uniform(-0.2, 0.2, points.shape) * arena.cell_size
    column, row = np.floor(points / arena.cell_size).astype(int).T
    column_after, row_after = np.floor(steps / arena.cell_size).astype(int).T
    within = (column == column_after) & (row == row_after) & (arena.zones[row, column] != 0)
    values = arena.distances.sample(points)
    assert (values >= 0.0).all()
    zones = arena.zones[row, column]
    assert (values[zones == 2, 0] == 0.0).all()
    assert (values[zones == 3, 1] == 0.0).all()
    change = np.abs(arena.distances.sample(steps) - values)[within]
    length = np.hypot(*(steps - points)[within].T)
    # Bilinear reading of a distance is steeper than 1 only across a crease, by less than sqrt(2).
    assert (change <= 1.42 * length[:, None] + 1e-9).all()
    assert np.mean(change > 1.001 * length[:, None]) < 0.03


@given(st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9)), min_size=1, max_size=40), st.integers(1, 5))
def test_a_point_reads_the_same_bits_in_every_batch(points: list[tuple[float, float]], copies: int) -> None:
    distances = PAPER.distances
    batch = np.array(points)
    together = distances.sample(np.stack([batch] * copies))
    alone = np.stack([distances.sample(point) for point in batch])
    assert together.shape == (copies, len(points), 2)
    assert all((part == alone).all() for part in together)
    assert np.isfinite(together).all()


PAPER = load_arena("paper")


def test_beyond_the_map_the_edge_counts() -> None:
    width, height = PAPER.size
    outside, edge = np.array([[-1.0, 0.6], [width + 5, height + 5]]), np.array([[0.0, 0.6], [width, height]])
    assert PAPER.distances.sample(outside) == pytest.approx(PAPER.distances.sample(edge))
