import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.arena import Arena, Zone, arena_names, load_arena
from robosim.arena.geometry import clear_of_walls, components, disc_places, passage, rectangles, tunnel_length


def cells(text: str, of: str = "T") -> np.ndarray:
    return np.array([[character in of for character in line] for line in text.split()])


def masks() -> st.SearchStrategy[np.ndarray]:
    def mask(shape: tuple[int, int], bits: int) -> np.ndarray:
        flat = [(bits >> place) & 1 for place in range(shape[0] * shape[1])]
        return np.array(flat, dtype=bool).reshape(shape)

    sides = st.integers(1, 7)
    return st.builds(mask, st.tuples(sides, sides), st.integers(0, 2**49 - 1))


@given(masks())
def test_rectangles_cover_each_cell_once_and_nothing_else(mask: np.ndarray) -> None:
    times = np.zeros(mask.shape, dtype=int)
    for x0, y0, x1, y1 in rectangles(mask):
        times[y0:y1, x0:x1] += 1
    assert (times == mask).all()


@given(masks())
def test_components_are_what_flooding_finds(mask: np.ndarray) -> None:
    label = components(mask)
    assert ((label >= 0) == mask).all()
    flooded = np.where(mask, np.arange(mask.size).reshape(mask.shape), -1)
    for _ in range(mask.size):
        for a, b in ((flooded[1:], flooded[:-1]), (flooded[:, 1:], flooded[:, :-1])):
            both = (a >= 0) & (b >= 0)
            a[both] = np.maximum(a, b)[both]
            b[both] = np.maximum(a, b)[both]
    pairs = set(zip(label[mask].tolist(), flooded[mask].tolist(), strict=True))
    assert len(pairs) == len({label for label, _ in pairs}) == len({flood for _, flood in pairs})


@pytest.mark.parametrize(
    ("text", "length"),
    [
        ("H..S", 0),
        ("HTTTS", 3),
        ("HTTTS HTTTS", 3),
        (".TTT# ###T# ###TS", 5),
        (".TTTT# .TTTT# ###TT# ###TT# ###SS#", 6),
        ("HTTS. ####. HTTTS", 3),
        ("HTTTT", 4),
    ],
)
def test_tunnel_length_counts_along_the_axis(text: str, length: int) -> None:
    assert tunnel_length(cells(text, "T"), cells(text, "HST.")) == length


def test_passage_needs_width_from_end_to_end() -> None:
    text = "HH..SS HH..SS HH##SS"
    free, home, source = (cells(text, of) for of in ("HS.", "H", "S"))
    assert (passage(free, home, source, 1) == free).all()
    assert (passage(free, home, source, 2) == free).all()
    assert not passage(free, home, source, 3).any()
    assert not passage(free, home, source, 9).any()


def gap_to_walls(arena: Arena, points: np.ndarray) -> np.ndarray:
    x0, y0, x1, y1 = (side[:, None] for side in arena.walls.T)
    x, y = points.T
    return np.hypot(x - np.clip(x, x0, x1), y - np.clip(y, y0, y1)).min(axis=0)


def zone_at(arena: Arena, points: np.ndarray) -> np.ndarray:
    column, row = np.floor((points - 1e-9) / arena.cell_size).astype(int).T
    return arena.zones[row, column]


@pytest.mark.parametrize("name", arena_names())
def test_places_keep_clear_of_walls_and_of_each_other(name: str) -> None:
    arena = load_arena(name)
    for places, radius, zone in (
        (arena.start_places, arena.robot.outer_radius, Zone.HOME),
        (arena.pellet_places, arena.pellets.radius, Zone.SOURCE),
    ):
        apart = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
        assert apart[~np.eye(len(places), dtype=bool)].min() > 2.04 * radius
        assert gap_to_walls(arena, places).min() > 1.02 * radius
        # A place at the left or lower edge of its zone counts to the zone.
        assert ((zone_at(arena, places) == zone) | (zone_at(arena, places + 2e-9) == zone)).all()
    # The nose of some robot can come to every pellet: it runs along walls at half the robot's width.
    sheets = [group.sheet for group in arena.groups] or [arena.robot]
    narrow = min(min(sheet.length, sheet.width) for sheet in sheets)
    assert gap_to_walls(arena, arena.pellet_places).min() > 0.5 * narrow
    assert len(arena.start_places) == arena.capacity
    assert len(arena.pellet_places) * 0.9 >= arena.pellets.count


@pytest.mark.parametrize("name", arena_names())
def test_wall_rectangles_are_the_wall_cells(name: str) -> None:
    arena = load_arena(name)
    times = np.zeros(arena.zones.shape, dtype=int)
    for x0, y0, x1, y1 in np.rint(arena.walls / arena.cell_size).astype(int):
        times[y0:y1, x0:x1] += 1
    assert (times == (arena.zones == Zone.WALL)).all()


def test_a_zone_in_two_parts_is_filled_in_both() -> None:
    zone = cells("......... .HH...HH. .HH...HH. .........", "H")
    places = disc_places(zone, ~cells("......... .HH...HH. .HH...HH. .........", "H."), 0.1, 0.02, 0.04, 1000)
    assert (places[:, 0] < 0.45).sum() == (places[:, 0] > 0.45).sum() > 10


@given(st.floats(0.01, 0.35), st.floats(0.0, 0.6), st.floats(0.0, 0.5))
def test_clear_of_walls_agrees_with_distance_to_each_wall_cell(radius: float, x: float, y: float) -> None:
    wall = cells("###### #..#.# #....# #.##.# ######", "#")
    gaps = [
        np.hypot(x - np.clip(x, c * 0.1, c * 0.1 + 0.1), y - np.clip(y, r * 0.1, r * 0.1 + 0.1))
        for r, c in np.argwhere(wall)
    ]
    if abs(min(gaps) - radius) > 1e-9:
        assert clear_of_walls(np.array([[x, y]]), radius, wall, 0.1)[0] == (min(gaps) > radius)
