import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import robosim
from robosim.arena import Arena
from robosim.arena.picture import ZONE_COLOURS
from robosim.envs.render import HELD_PELLET, LOOSE_PELLET, MODES, Painter, outline_distance
from robosim.episodes.frame import Frame
from robosim.robot.sheet import RobotSheet


@pytest.fixture(scope="module")
def arena() -> Arena:
    return robosim.load_arena("paper")


@pytest.fixture(scope="module")
def frame() -> Frame:
    env = robosim.vector_env("paper", robots=2)
    env.reset(0)
    return env.frame()


def colour_at(picture: np.ndarray, arena: Arena, x: float, y: float) -> tuple[int, ...]:
    width, height = arena.size
    row = int((height - y) / height * picture.shape[0])
    column = int(x / width * picture.shape[1])
    return tuple(picture[row, column].tolist())


def has_colour(picture: np.ndarray, colour: tuple[int, ...]) -> bool:
    return bool((picture == colour).all(axis=2).any())


def test_north_is_up_and_every_zone_has_its_colour(arena: Arena, frame: Frame) -> None:
    nothing = replace(
        frame,
        pose=frame.pose[:0],
        mode=frame.mode[:0],
        pellet_status=np.full_like(frame.pellet_status, 2),
        pheromone=np.zeros_like(frame.pheromone),
    )
    picture = Painter(arena).draw(nothing)
    assert picture.dtype == np.uint8
    for row in range(arena.rows):
        for column in range(arena.columns):
            x, y = (column + 0.5) * arena.cell_size, (row + 0.5) * arena.cell_size
            assert colour_at(picture, arena, x, y) == ZONE_COLOURS[arena.zones[row, column]]


@pytest.mark.parametrize("mode", range(7))
def test_a_robot_has_the_colour_of_its_mode_behind_its_nose(arena: Arena, frame: Frame, mode: int) -> None:
    x, y, heading = 1.7, 0.6, 0.8
    one = replace(
        frame,
        pose=np.array([[x, y, heading]]),
        mode=np.array([mode], dtype=np.uint8),
        pheromone=frame.pheromone * 0,
    )
    picture = Painter(arena).draw(one)
    back = 0.25 * arena.robot.length
    assert colour_at(picture, arena, x - back * np.cos(heading), y - back * np.sin(heading)) == MODES[mode]
    assert colour_at(picture, arena, x + back * np.cos(heading), y + back * np.sin(heading)) == (
        255,
        255,
        255,
    )


def test_pellets_show_where_they_are_and_whether_they_are_held(arena: Arena, frame: Frame) -> None:
    pellets = np.zeros_like(frame.pellets)
    pellets[:3] = [[1.2, 0.55], [1.6, 0.55], [2.0, 0.55]]
    status = np.full_like(frame.pellet_status, 2)
    status[:2] = [0, 1]
    shown = replace(frame, pellets=pellets, pellet_status=status)
    picture = Painter(arena).draw(shown)
    assert colour_at(picture, arena, 1.2, 0.55) == LOOSE_PELLET
    assert colour_at(picture, arena, 1.6, 0.55) == HELD_PELLET
    none = Painter(arena).draw(replace(shown, pellet_status=np.full_like(status, 2)))
    assert not has_colour(none, LOOSE_PELLET)
    assert colour_at(picture, arena, 2.0, 0.55) == colour_at(none, arena, 2.0, 0.55)


def test_pheromone_darkens_the_floor_and_leaves_walls_alone(arena: Arena, frame: Frame) -> None:
    empty = replace(
        frame, pose=frame.pose[:0], mode=frame.mode[:0], pellet_status=np.full_like(frame.pellet_status, 2)
    )
    clean = Painter(arena).draw(replace(empty, pheromone=np.zeros_like(frame.pheromone)))
    marked = Painter(arena).draw(replace(empty, pheromone=np.ones_like(frame.pheromone)))
    wall = (clean == ZONE_COLOURS[0]).all(axis=2)
    assert np.array_equal(clean[wall], marked[wall])
    assert (marked[~wall].sum(axis=1) < clean[~wall].sum(axis=1)).all()


def test_who_draws_nothing_holds_no_picture(arena: Arena) -> None:
    tracemalloc.start()
    painters = [Painter(arena) for _ in range(10)]
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(painters) == 10
    assert held < 100_000


def test_drawing_twice_gives_the_same_picture_and_a_robot_at_the_border_none_the_less(
    arena: Arena, frame: Frame
) -> None:
    painter = Painter(arena)
    assert np.array_equal(painter.draw(frame), painter.draw(frame))
    corners = replace(frame, pose=np.array([[0.0, 0.0, 1.0], [*arena.size, 2.0]]))
    assert painter.draw(corners).shape == painter.draw(frame).shape


@given(st.floats(-1, 1), st.floats(-1, 1), st.sampled_from([("capsule", 0.2), ("box", 0.2), ("circle", 0.1)]))
def test_outline_distance_equals_the_distance_to_sampled_points(
    forward: float, sideways: float, kind: tuple[str, float]
) -> None:
    shape, length = kind
    sheet = RobotSheet(shape=shape, length=length, width=0.1)
    distance = outline_distance(sheet, np.array(forward), np.array(sideways))
    outline = points_of_outline(shape, length, 0.1)
    nearest = np.hypot(outline[:, 0] - forward, outline[:, 1] - sideways).min()
    assert abs(distance) == pytest.approx(nearest, abs=1e-3)


def points_of_outline(shape: str, length: float, width: float) -> np.ndarray:
    share = np.linspace(0.0, 1.0, 2001)
    if shape == "box":
        x, y = length * (share - 0.5), width * (share - 0.5)
        sides = [
            (x, 0 * x + width / 2),
            (x, 0 * x - width / 2),
            (0 * y + length / 2, y),
            (0 * y - length / 2, y),
        ]
        return np.concatenate([np.stack(side, axis=1) for side in sides])
    half, radius, angle = (length - width) / 2, width / 2, np.pi * (share - 0.5)
    front = np.stack([half + radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    x = half * (2 * share - 1)
    return np.concatenate(
        [front, front * [-1, 1], *(np.stack([x, 0 * x + r], axis=1) for r in (radius, -radius))]
    )
