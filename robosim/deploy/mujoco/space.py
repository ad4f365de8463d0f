"""One environment's bodies in MuJoCo, for one episode."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Arena
from robosim.deploy.mujoco.model import (
    LIFT,
    NUMBERS_OF_BODY,
    PAD_GAIN,
    PAD_SPEED,
    SIDES,
    model_text,
    pellet_centre,
    solver_steps,
)
from robosim.world.draws import Draws

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_NO_BODY = -1
_FORCES = np.arange(3)
"""Of a contact with friction: one along its normal, two across."""
_SPACES = itertools.count()
_UNSTABLE = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)
"""Warnings after which MuJoCo puts everything back to where the episode began."""


class MujocoSpace:
    """The bodies of one environment during one episode (`robosim.world.physics.bodies.Bodies`).

    `commands` [robots, 3] hold wheel speeds (left, right; rad/s) in their first two columns.
    """

    def __init__(self, arena: Arena, draws: Draws, commands: Floats) -> None:
        self._arena = arena
        self._commands = commands
        self.model = mujoco.MjModel.from_xml_string(model_text(arena, draws))
        """MuJoCo's model of the episode, to be looked at."""
        self.data = mujoco.MjData(self.model)
        """MuJoCo's state of it, to be looked at."""
        self._robots, self._pellets = len(draws.robot_pose), len(draws.pellet_place)
        self._substeps = arena.timing.substeps
        self._steps = solver_steps(arena)
        self._height = pellet_centre(arena)
        count = self._robots + self._pellets
        first = next(_SPACES) * (count + 1)
        ids = np.arange(first, first + count + 1, dtype=np.uintp)
        self.body_ids, self.ground_id = ids[:-1], ids[-1]
        self._ids = ids
        self._absent: set[int] = set()
        self._find_parts()
        self._rows: list[tuple[NDArray[np.uintp], Floats]] = []
        self._length = 0

    def _find_parts(self) -> None:
        model, robots = self.model, range(self._robots)
        free = [model.joint(f"robot{one}") for one in robots]
        free += [model.joint(f"pellet{one}") for one in range(self._pellets)]
        place = np.array([int(joint.qposadr[0]) for joint in free])
        self._place = place[:, None] + np.arange(NUMBERS_OF_BODY)
        self._speed = np.array([int(joint.dofadr[0]) for joint in free])[:, None] + np.array([0, 1, 5])
        pads = [[model.joint(f"pad{axis}{one}") for axis in "xy"] for one in robots]
        self._pad_place = np.array([[int(joint.qposadr[0]) for joint in pair] for pair in pads])
        self._pad_speed = np.array([[int(joint.dofadr[0]) for joint in pair] for pair in pads])
        self._pad_body = [model.body(f"pad{one}").id for one in robots]
        self._pellet_body = [model.body(f"pellet{one}").id for one in range(self._pellets)]
        self._wheels = np.array(
            [[model.actuator(f"{side}{one}").id for side in ("left", "right")] for one in robots]
        )
        self._pads = np.array([[model.actuator(f"pad{axis}{one}").id for axis in "xy"] for one in robots])
        self._grips = [model.equality(f"grip{one}").id for one in robots] if self._pellets else []
        self._grip_of: dict[int, int] = {}
        # Which of our bodies a side belongs to; walls to the ground, and what rests on the ground to none.
        owner = np.full(model.ngeom, _NO_BODY)
        sides = (model.geom_contype & SIDES) > 0
        owner[sides] = self._robots + self._pellets
        for one in robots:
            owner[model.geom(f"side{one}").id] = one
        for one in range(self._pellets):
            owner[model.geom(f"rim{one}").id] = self._robots + one
        self._owner = owner
        self._key = np.array([model.ngeom, 1])
        self._touching: list[Integers] = []

    def drive(self) -> None:
        """Go over to the wheel speeds in `commands` in a substep, and hold them for the control period."""
        self.advance()

    def advance(self) -> None:
        """Run the solver for one control period."""
        for _ in range(self._substeps):
            self.drive_substep()

    def drive_substep(self) -> None:
        """Go over to the wheel speeds in `commands`, evenly through one substep, and note what touches."""
        data = self.data
        data.ctrl[self._pads] = np.clip(-PAD_GAIN * data.qpos[self._pad_place], -PAD_SPEED, PAD_SPEED)
        before = data.ctrl[self._wheels]
        change = (self._commands[:, :2] - before) / self._steps
        for step in range(1, self._steps + 1):
            data.ctrl[self._wheels] = before + step * change
            mujoco.mj_step(self.model, data)
        self._note_contacts()

    def _note_contacts(self) -> None:
        """Note which sides touch now."""
        geoms = self.data.contact.geom
        sides = (self._owner[geoms] >= 0).all(axis=1)
        self._touching.append(geoms[sides])

    def _pressing(self) -> tuple[Integers, Floats]:
        """Return which sides touch now [n, 2], each pair once, and impulse, 0, point x, y [n, 4] of each."""
        contact = self.data.contact
        geoms = contact.geom
        rows = np.flatnonzero((self._owner[geoms] >= 0).all(axis=1))
        # Boxes touch in several points.
        keys, which = np.unique(geoms[rows] @ self._key, return_inverse=True)
        address = contact.efc_address[rows]
        forces = self.data.efc_force[np.maximum(address, 0)[:, None] + _FORCES]
        force = np.where(address >= 0, np.sqrt((forces * forces).sum(axis=1)), 0.0)
        count = len(keys)
        impulse = np.bincount(which, force, count) * self._arena.timing.substep
        number = np.bincount(which, minlength=count)
        x, y = (np.bincount(which, contact.pos[rows, axis], count) / number for axis in (0, 1))
        return keys, np.stack([impulse, np.zeros(count), x, y], axis=1)

    def poses(self) -> Floats:
        """Return x, y, angle of all bodies, [n, 3], robots first."""
        where = self.data.qpos[self._place]
        w, x, y, z = where[:, 3:].T
        angle = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        return np.stack([where[:, 0], where[:, 1], angle], axis=1)

    def bodies(self) -> tuple[NDArray[np.uintp], Floats]:
        """Return ids [n] and x, y, angle, vx, vy, rate [n, 6] of all bodies that are there, robots first.

        RuntimeError if the solver has become unstable: what it says since is no outcome.
        """
        if any(self.data.warning[int(kind)].number for kind in _UNSTABLE):
            raise RuntimeError("MuJoCo has become unstable in this arena, with these masses and speeds.")
        all_of_them = np.concatenate([self.poses(), self.data.qvel[self._speed]], axis=1)
        if not self._absent:
            return self.body_ids, all_of_them
        there = np.ones(len(all_of_them), dtype=np.bool_)
        there[[self._robots + pellet for pellet in self._absent]] = False
        return self.body_ids[there], all_of_them[there]

    def forget_contacts(self) -> None:
        """Begin a new list of contacts."""
        self._rows = []
        self._length = 0

    def list_contacts(self) -> int:
        """Append the control period's contacts to the list; returns its length.

        What touched after any of its substeps is listed; pairs that have parted again
        with impulse 0 and no place.
        """
        touched = np.unique(np.concatenate(self._touching) @ self._key)
        self._touching = []
        if not len(touched):
            return self._length
        pressing, rows = self._pressing()
        parted = np.setdiff1d(touched, pressing)
        keys = np.concatenate([pressing, parted])
        pairs = np.stack(np.divmod(keys, self._key[0]), axis=1)
        rows = np.concatenate([rows, np.zeros((len(parted), 4))])
        self._rows.append((self._ids[self._owner[pairs]], rows))
        self._length += len(rows)
        return self._length

    def contacts(self) -> tuple[NDArray[np.uintp], Floats]:
        """Return the list: body ids [n, 2], and impulse, 0, point x, y [n, 4]."""
        if not self._rows:
            return np.zeros((0, 2), dtype=np.uintp), np.zeros((0, 4))
        return np.concatenate([ids for ids, _ in self._rows]), np.concatenate(
            [rows for _, rows in self._rows]
        )

    def grip(self, robot: int, pellet: int) -> tuple[float, float]:
        """Weld a pellet to a gripper and lift it; returns its place in the robot's frame, m."""
        model, data = self.model, self.data
        data.qpos[self._pad_place[robot]] = 0.0
        data.qvel[self._pad_speed[robot]] = 0.0
        data.qpos[self._place[self._robots + pellet, 2]] += LIFT
        mujoco.mj_kinematics(model, data)
        pad, held = self._pad_body[robot], self._pellet_body[pellet]
        frame = data.xmat[pad].reshape(3, 3)
        inverse, turn = np.zeros(4), np.zeros(4)
        mujoco.mju_negQuat(inverse, data.xquat[pad])
        mujoco.mju_mulQuat(turn, inverse, data.xquat[held])
        weld = self._grips[robot]
        model.eq_obj2id[weld] = held
        # Anchor, place and turn of the pellet in the gripper's frame, share of torques.
        model.eq_data[weld, :11] = [0.0, 0.0, 0.0, *((data.xpos[held] - data.xpos[pad]) @ frame), *turn, 1.0]
        data.eq_active[weld] = 1
        self._grip_of[pellet] = weld
        x, y, heading = self.poses()[robot]
        dx, dy = data.xpos[held][:2] - (x, y)
        cos, sin = np.cos(heading), np.sin(heading)
        return float(cos * dx + sin * dy), float(cos * dy - sin * dx)

    def release(self, pellet: int) -> None:
        """Let a held pellet drop to the ground where it is."""
        self.data.eq_active[self._grip_of.pop(pellet)] = 0

    def place(self, pellet: int, place: Floats, velocity: tuple[float, float] = (0.0, 0.0)) -> None:
        """Put a pellet to a place, at rest or moving (m/s); an absent one comes back."""
        self._absent.discard(pellet)
        self._put(pellet, float(place[0]), float(place[1]))
        self.data.qvel[self._speed[self._robots + pellet, :2]] = velocity

    def take_out(self, pellet: int) -> None:
        """Put a loose pellet beside the arena, where it rests until `place` brings it back."""
        self._absent.add(pellet)
        apart = 3.0 * self._arena.pellets.radius
        self._put(pellet, -self._arena.cell_size - apart, apart * pellet)

    def _put(self, pellet: int, x: float, y: float) -> None:
        body = self._robots + pellet
        self.data.qpos[self._place[body]] = (x, y, self._height, 1.0, 0.0, 0.0, 0.0)
        first = self._speed[body, 0]
        self.data.qvel[first : first + 6] = 0.0

    def cohere(self, touching: Integers, positions: Floats) -> None:
        """Nothing holds together here: `MujocoWorld` refuses pellets that would."""
