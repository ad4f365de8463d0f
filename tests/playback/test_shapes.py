import numpy as np
import pytest

from robosim.arena import Zone, load_arena
from robosim.arena.outline import body_outline
from robosim.playback.shapes import body_strips, gripper, wall_edges
from robosim.robot.sheet import RobotSheet

SHEETS = [
    RobotSheet(),
    RobotSheet(shape="capsule", length=0.16, width=0.08),
    RobotSheet(shape="box", length=0.12, width=0.09),
]


def _distance_to_strips(points, strips):
    ends = np.array(strips)
    start, along = ends[:, 0], ends[:, 1] - ends[:, 0]
    share = ((points[:, None] - start) * along).sum(axis=-1) / (along**2).sum(axis=-1)
    nearest = start + np.clip(share, 0.0, 1.0)[..., None] * along
    return np.linalg.norm(points[:, None] - nearest, axis=-1).min(axis=1)


@pytest.mark.parametrize("sheet", SHEETS, ids=lambda sheet: sheet.shape)
def test_body_strips_fill_the_outline_without_holes_and_do_not_leave_it(sheet):
    strips, radius = body_strips(sheet)
    boundary = body_outline(sheet)[:-1]
    inside = np.concatenate([share * boundary for share in np.linspace(0.0, 0.9, 20)])
    assert (_distance_to_strips(inside, strips) <= radius).all()
    reach = np.array(strips).reshape(-1, 2)
    assert np.abs(reach[:, 0]).max() + radius <= 0.5 * sheet.length * 1.001
    assert np.abs(reach[:, 1]).max() + radius <= 0.5 * sheet.width * 1.001


@pytest.mark.parametrize("sheet", SHEETS, ids=lambda sheet: sheet.shape)
def test_gripper_fingers_begin_on_the_body_and_end_before_its_nose(sheet):
    strips, radius = body_strips(sheet)
    for start, end in gripper(sheet, pellet_radius=0.02):
        assert _distance_to_strips(np.array([start]), strips)[0] == pytest.approx(radius, abs=1e-3)
        assert end[0] > 0.5 * sheet.length
        assert start[1] == end[1]


def test_wall_edges_are_the_sides_that_a_wall_shares_with_anything_else():
    arena = load_arena("paper")
    expected = set()
    for row in range(arena.rows):
        for column in range(arena.columns):
            if arena.zones[row, column] == Zone.WALL:
                continue
            for side, beyond in enumerate(
                [(row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)]
            ):
                if arena.zones[beyond] == Zone.WALL:
                    corners = [
                        ((column, row), (column + 1, row)),
                        ((column, row + 1), (column + 1, row + 1)),
                        ((column, row), (column, row + 1)),
                        ((column + 1, row), (column + 1, row + 1)),
                    ][side]
                    expected.add(corners)
    found = {
        tuple((round(x / arena.cell_size), round(y / arena.cell_size)) for x, y in edge)
        for edge in wall_edges(arena)
    }
    assert found == expected
    assert len(wall_edges(arena)) == len(expected)
