import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.arena.outline import body_outline, first_touched, placed, touches_wall
from robosim.robot.sheet import BodyShape, RobotSheet

CAPSULE = RobotSheet(shape="capsule", length=0.4, width=0.2)
WALL = np.array([[character == "#" for character in row] for row in ["######", "#....#", "#....#", "######"]])


def inside(sheet: RobotSheet, pose: tuple[float, float, float], points: np.ndarray) -> np.ndarray:
    """Whether points [n, 2] lie in the outline, from its definition."""
    x, y, heading = pose
    dx, dy = (points - [x, y]).T
    along = np.abs(math.cos(heading) * dx + math.sin(heading) * dy)
    across = np.abs(math.cos(heading) * dy - math.sin(heading) * dx)
    if sheet.shape == "box":
        return (along <= sheet.length / 2) & (across <= sheet.width / 2)
    straight = 0.0 if sheet.shape == "circle" else (sheet.length - sheet.width) / 2
    return np.hypot(np.maximum(along - straight, 0.0), across) <= sheet.width / 2


POSE = st.tuples(st.floats(0.0, 0.6), st.floats(0.0, 0.6), st.floats(-4.0, 4.0))
SHAPE = st.sampled_from(["circle", "capsule", "box"])
GRID = np.stack(np.meshgrid(np.linspace(-0.3, 0.9, 241), np.linspace(-0.3, 0.9, 241)), axis=-1).reshape(-1, 2)


def sheet_of(shape: BodyShape, grow: float = 0.0) -> RobotSheet:
    length = 0.2 if shape == "circle" else 0.4
    return RobotSheet(shape=shape, length=length + grow, width=0.2 + grow)


@given(SHAPE, POSE, POSE)
def test_touching_is_sharing_a_point(
    shape: BodyShape, a: tuple[float, float, float], b: tuple[float, float, float]
) -> None:
    sheet = sheet_of(shape)
    if (inside(sheet, a, GRID) & inside(sheet, b, GRID)).any():
        assert first_touched([sheet] * 2, [a, b], 1) == 0
    # The grid's points lie 5 mm apart, so outlines grown by 10 mm share one of them when these touch.
    elif not (inside(sheet_of(shape, 0.01), a, GRID) & inside(sheet_of(shape, 0.01), b, GRID)).any():
        assert first_touched([sheet] * 2, [a, b], 1) is None


def test_the_first_that_is_touched_is_named() -> None:
    poses = [(1.0, 1.0, 0.0), (0.0, 0.0, 0.0), (0.05, 0.0, 0.0), (0.0, 0.1, 0.0)]
    assert [first_touched([CAPSULE] * 4, poses, index) for index in range(4)] == [None, None, 1, 1]


@pytest.mark.parametrize(
    ("pose", "touches"),
    [
        ((0.45, 0.30, 0.0), False),
        ((0.45, 0.36, 0.0), False),
        ((0.45, 0.36, math.pi / 2), True),
        ((0.45, 0.30, math.pi / 2), True),
        ((0.30, 0.30, 0.0), True),
        ((-5.0, 0.3, 0.0), True),
        ((0.01, 0.01, 0.0), True),
    ],
)
def test_a_capsule_between_walls(pose: tuple[float, float, float], touches: bool) -> None:
    sheet = RobotSheet(shape="capsule", length=0.31, width=0.15)
    assert touches_wall(sheet, pose, WALL, 0.15) is touches


@pytest.mark.parametrize("shape", ["circle", "capsule", "box"])
def test_the_outline_is_closed_and_has_the_size_of_the_sheet(shape: BodyShape) -> None:
    sheet = sheet_of(shape)
    points = body_outline(sheet)
    assert points[0].tolist() == points[-1].tolist()
    assert np.ptp(points[:, 0]) == pytest.approx(sheet.length)
    assert np.ptp(points[:, 1]) == pytest.approx(sheet.width)
    assert np.linalg.norm(points, axis=1).max() == pytest.approx(sheet.outer_radius)


@given(SHAPE, POSE)
def test_a_placed_outline_is_the_edge_of_the_body_there(
    shape: BodyShape, pose: tuple[float, float, float]
) -> None:
    points = placed(body_outline(sheet_of(shape)), pose)
    assert inside(sheet_of(shape, 1e-9), pose, points).all()
    assert not inside(sheet_of(shape, -1e-9), pose, points).any()
