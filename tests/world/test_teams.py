"""Robots of unlike data sheets in one physical world."""

from __future__ import annotations

import numpy as np
import pytest

from robosim.arena import load_arena
from robosim.arena.model import Arena
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError
from robosim.world.physics import PhysicsWorld

MAP = """
name = "room"
cell_size = 0.2
map = '''
############
#..........#
#H........S#
#..........#
#..........#
############
'''
[pellets]
count = 1
"""
SLOW = "max_wheel_speed = 5.0\nmax_wheel_acceleration = 40.0"
LONG = 'shape = "capsule"\nlength = 0.18\nwidth = 0.12\nmass = 1.5\ntraction = 0.3\nmax_wheel_speed = 16.0'
POSES = [[0.5, 0.9, 0.3], [1.0, 0.9, -2.0], [1.5, 0.9, 1.0], [2.0, 0.9, 3.0]]


def arena_with(poses: list[list[float]], *groups: str) -> Arena:
    tables = "".join(
        f'[[groups]]\nname = "group {number}"\n[groups.robot]\n{robot}\n'
        for number, robot in enumerate(groups)
    )
    return load_arena(f"{MAP}[start]\nposes = {poses}\n{tables}")


def driven(arena: Arena, robots: int, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return poses and wheel speeds after each control period of `commands` [periods, 1, robots, 2]."""
    world = PhysicsWorld(arena, robots, 1, "cardinal")
    world.reset([np.random.SeedSequence(0)])
    poses, wheels = [], []
    for command in commands:
        world.drive(command)
        poses.append(world.state.pose[0].copy())
        wheels.append(world.wheel_speeds[0].copy())
    return np.array(poses), np.array(wheels)


def test_each_robot_drives_as_its_own_sheet_says() -> None:
    mixed = arena_with(POSES, SLOW, LONG)
    rng = np.random.default_rng(1)
    commands = rng.uniform(-25.0, 25.0, (12, 1, 4, 2))
    poses, wheels = driven(mixed, 4, commands)
    plain = np.zeros((4, 2))
    for period, command in enumerate(commands[:, 0]):
        for robot, sheet in enumerate(mixed.team(4).sheets):
            most = sheet.max_wheel_acceleration * mixed.timing.control_period
            for wheel in range(2):
                change = min(max(command[robot, wheel] - plain[robot, wheel], -most), most)
                speed = plain[robot, wheel] + change
                plain[robot, wheel] = min(max(speed, -sheet.max_wheel_speed), sheet.max_wheel_speed)
        np.testing.assert_allclose(wheels[period], plain, rtol=0, atol=1e-12)
    assert np.abs(wheels[:, 0::2]).max() == 5.0
    assert np.abs(wheels[:, 1::2]).max() == 16.0
    # Nobody meets anybody, so each comes to where it would have come in a team of its own kind.
    for kind, robot_table in enumerate((SLOW, LONG)):
        own = [POSES[kind], POSES[kind + 2]]
        equals = load_arena(f"{MAP}[robot]\n{robot_table}\n[start]\nposes = {own}\n")
        alone, _ = driven(equals, 2, commands[:, :, kind::2])
        assert np.array_equal(poses[:, kind::2], alone)


def test_how_far_a_robot_comes_is_told_robot_by_robot() -> None:
    world = PhysicsWorld(arena_with(POSES, SLOW, LONG), 3, 1, "cardinal")
    period = world.arena.timing.decision_period
    assert np.asarray(world.travel).tolist() == [sheet.top_speed * period for sheet in world.team.sheets]
    assert np.asarray(world.turn).tolist() == [sheet.top_turn_rate * period for sheet in world.team.sheets]


@pytest.mark.parametrize("actions", ["cardinal", "wheels", "wheels-9"])
@pytest.mark.parametrize("encoding", ["paper", "expanded"])
def test_groups_of_the_same_sheet_move_as_a_team_of_equals(actions: str, encoding: str) -> None:
    equals = VectorEnv(arena_with(POSES), robots=4, num_envs=2, actions=actions, encoding=encoding)
    named = VectorEnv(
        arena_with(POSES, "mass = 0.4", "mass = 0.4"),
        robots=4,
        num_envs=2,
        actions=actions,
        encoding=encoding,
    )
    first, second = equals.reset(), named.reset()
    rng = np.random.default_rng(2)
    own = [number for number, name in enumerate(named.layout.names) if not name.startswith("kind")]
    for _ in range(30):
        chosen = rng.integers(0, equals.num_actions, (2, 4))
        one, other = equals.step(chosen), named.step(chosen)
        first, second = one.observation, other.observation
        assert np.array_equal(first, second[..., own])
        assert np.array_equal(one.reward, other.reward)
    assert np.array_equal(equals.world.state.pose, named.world.state.pose)


def test_a_mixed_team_sees_of_which_kind_each_robot_is() -> None:
    env = VectorEnv(arena_with(POSES, SLOW, LONG), robots=4)
    kinds = [number for number, name in enumerate(env.layout.names) if name.startswith("kind")]
    assert [env.layout.names[number] for number in kinds] == ["kind group 0", "kind group 1"]
    assert env.reset()[0][:, kinds].tolist() == [[1.0, 0.0], [0.0, 1.0], [1.0, 0.0], [0.0, 1.0]]


def test_the_grid_refuses_unlike_bodies_in_one_sentence() -> None:
    with pytest.raises(InputError) as error:
        VectorEnv(arena_with(POSES, SLOW, LONG), robots=4, world="grid")
    assert str(error.value) == (
        "groups: group 1 has another data sheet than group 0, but all must have the same in the grid, where "
        "robots have no bodies and drive a cell in a decision."
    )
