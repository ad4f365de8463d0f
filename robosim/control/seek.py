"""What scripted controllers share: where robots stand on the map, who is close ahead, the pellet to take."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import GOALS
from robosim.errors import InputError
from robosim.robot.drivers import CARDINAL_STEPS
from robosim.robot.team import Role
from robosim.world.state import PelletStatus

if TYPE_CHECKING:
    from robosim.envs.vector import VectorEnv

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]

KEEP_AHEAD = 0.2
"""Gap kept to a robot ahead, in robot diameters."""
SHOULDER = 0.8
"""Half-width of the strip ahead that must be clear, in robot diameters."""


def require_world(name: str, env: VectorEnv) -> None:
    """Raise InputError for environments in other processes: their world is not there to be looked into."""
    if not hasattr(env, "world"):
        raise InputError(f"{name}: looks into the world of the environments, so workers must be 1.")


def require_cardinal(name: str, env: VectorEnv) -> None:
    """Raise InputError if the environment's actions are not those that controller `name` drives by.

    Or if the environments run in other processes, where it cannot see robots and pellets.
    """
    require_world(name, env)
    if env.layout.actions != "cardinal":
        raise InputError(
            f"{name}: drives by cardinal actions only, "
            f"and the environment's actions are {env.layout.actions!r}."
        )


def require_all_round(name: str, env: VectorEnv) -> None:
    """Raise InputError for a team in which controller `name` does not know every robot's part."""
    if not env.world.team.all_round:
        raise InputError(f"{name}: knows of no roles, and the robots here dig or transport; `lanes` does.")


def cells_of(env: VectorEnv) -> Integers:
    """Return (column, row) of the robots' cells on a map padded by one wall, [envs, robots, 2]."""
    place = env.world.state.pose[..., :2]
    return np.floor(place * (1.0 / env.arena.cell_size)).astype(np.int64) + 1


def moves_blocked_by_robots(env: VectorEnv) -> Bools:
    """Return which of the four moves another robot close ahead blocks, [envs, robots, 4]."""
    if env.world.on_cells:
        return _taken_cells(env)
    place = env.world.state.pose[..., :2]
    width = env.world.team.reach[..., None]
    apart = place[:, None, :, :] - place[:, :, None, :]
    steps = CARDINAL_STEPS[:4].astype(np.float64)
    along = apart[..., None, 0] * steps[:, 0] + apart[..., None, 1] * steps[:, 1]
    across = np.abs(apart[..., None, 0] * steps[:, 1] - apart[..., None, 1] * steps[:, 0])
    ahead = (along > 0.0) & (along < (1.0 + KEEP_AHEAD) * width + 2.0 * env.arena.pellets.radius)
    return np.asarray((ahead & (across < SHOULDER * width)).any(axis=2))


def pellets_to_take(env: VectorEnv) -> Bools:
    """Return which loose pellets are a robot's affair, [envs, robots, pellets].

    [envs, 1, pellets] where all are everybody's.
    """
    state, team, arena = env.world.state, env.world.team, env.arena
    loose = (state.pellet_status == PelletStatus.LOOSE)[:, None]
    if team.all_round:
        return np.asarray(loose)
    column, row = np.moveaxis((state.pellets * (1.0 / arena.cell_size)).astype(np.int64), 2, 0)
    takes = np.array([GOALS[Role(role)][1] for role in team.role])
    return np.asarray(loose & (arena.zones[row, column][:, None] == takes[:, None]))


def toward_pellets(env: VectorEnv, seekers: Bools, cell: Integers, cost: Floats) -> Floats:
    """Return costs [envs, robots, 4] that lead the seekers to the pellet they can grip soonest.

    `cell` is what `cells_of` returns, `cost` that of the four neighbouring cells, inf for walls. A pellet
    can be gripped when it lies ahead in the strip that the gripper sweeps up to the middle of the
    neighbouring cell. Where robots stand on cells, it is the pellet in the nearest cell.
    """
    if env.world.on_cells:
        return _toward_cells_with_pellets(env, seekers, cell, cost)
    state, sheet = env.world.state, env.world.team.sheet
    envs, robots = np.nonzero(seekers)
    pose = state.pose[envs, robots]
    target = (cell[envs, robots][:, None] + CARDINAL_STEPS[:4] - 0.5) * env.arena.cell_size
    direction = target - pose[:, None, :2]
    direction /= np.sqrt((direction**2).sum(axis=2, keepdims=True))
    apart = state.pellets[envs] - pose[:, None, :2]
    along = np.einsum("mac,mpc->map", direction, apart)
    across = np.abs(direction[..., 0:1] * apart[:, None, :, 1] - direction[..., 1:2] * apart[:, None, :, 0])
    sweep = 0.8 * (_of(robots, sheet.gripper_reach, env) + env.arena.pellets.radius)
    loose = _of_seekers(pellets_to_take(env), envs, robots)
    there = np.where(loose & (along > 0.0) & (across < sweep[:, None, None]), along, np.inf).min(axis=2)
    # Turning costs the distance that the robot could drive in the same time.
    along_heading = direction[..., 0] * np.cos(pose[:, 2:]) + direction[..., 1] * np.sin(pose[:, 2:])
    turn = np.arccos(np.clip(along_heading, -1, 1))
    there += turn * _of(robots, sheet.top_speed / sheet.top_turn_rate, env)[:, None]
    distance = np.where(loose[:, 0], (apart**2).sum(axis=2), np.inf)
    nearest = apart[np.arange(len(apart)), distance.argmin(axis=1)]
    # With nothing in reach, the general direction of the nearest pellet; always worse than a sure one.
    there = np.where(np.isfinite(there), there, 1e3 - np.einsum("mac,mc->ma", direction, nearest))
    changed = cost.copy()
    changed[envs, robots] = np.where(np.isfinite(cost[envs, robots]), there, np.inf)
    return changed


def _of_seekers(pellets: Bools, envs: Integers, robots: Integers) -> Bools:
    """Return rows [n, 1, pellets] of `pellets` [envs, robots or 1, pellets]."""
    return pellets[envs, robots if pellets.shape[1] > 1 else 0, None]


def _of(robots: Integers, value: Floats | float, env: VectorEnv) -> Floats:
    """Return what a data sheet's value is for each of `robots` [n]."""
    return np.broadcast_to(value, env.robots)[robots]


def _taken_cells(env: VectorEnv) -> Bools:
    """Return which of the four neighbouring cells another robot is in, [envs, robots, 4]."""
    cell = cells_of(env)
    around = cell[:, :, None] + CARDINAL_STEPS[:4]
    return np.asarray((around[:, :, :, None] == cell[:, None, None]).all(axis=-1).any(axis=3))


def _toward_cells_with_pellets(env: VectorEnv, seekers: Bools, cell: Integers, cost: Floats) -> Floats:
    """Return costs [envs, robots, 4] that lead the seekers to the nearest cell in which pellets lie.

    Of two as near, the one ahead costs less.
    """
    state = env.world.state
    envs, robots = np.nonzero(seekers)
    around = cell[envs, robots][:, None] + CARDINAL_STEPS[:4]
    pellets = np.floor(state.pellets[envs] * (1.0 / env.arena.cell_size)).astype(np.int64) + 1
    apart = np.abs(around[:, :, None] - pellets[:, None]).sum(axis=3).astype(np.float64)
    loose = _of_seekers(pellets_to_take(env), envs, robots)
    there = np.where(loose, apart, np.inf).min(axis=2, initial=1e3)
    heading = state.pose[envs, robots, 2, None]
    there -= 0.1 * (np.cos(heading) * CARDINAL_STEPS[:4, 0] + np.sin(heading) * CARDINAL_STEPS[:4, 1])
    changed = cost.copy()
    changed[envs, robots] = np.where(np.isfinite(cost[envs, robots]), there, np.inf)
    return changed
