"""An exported team at work on the laboratory's floor: from its poses to its velocities, turn by turn.

The policy decides once in a decision period, and its driver gives wheel speeds once in a control period, as
in training. The laboratory takes velocities once in a turn of 0.033 s: both periods are whole numbers of
turns (9 and 3 with those of robosim's arenas, 0.297 and 0.099 s), and velocities are held in between.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robosim.arena.distance import DistanceField
from robosim.arena.model import Arena, PelletSheet, Timing
from robosim.control.network import Networks, NetworkSpec
from robosim.control.player import Player
from robosim.deploy.robotarium.floor import VirtualFloor, checked_distances
from robosim.deploy.team import RealTeam
from robosim.discretise.observation import Columns, MoveGains, ObservationLayout
from robosim.discretise.pheromone import PheromoneConfig
from robosim.discretise.reward import RewardConfig
from robosim.robot.kinematics import body_twist, wheel_speeds_for
from robosim.robot.sheet import RobotSheet

Floats = NDArray[np.float64]

SETTINGS, ARRAYS = "team.json", "team.npz"
TURN = 0.033
"""Time between two commands, s."""
LEAST_APART = 0.135
"""Robots that come nearer, as the laboratory checks it, count as collided, m."""
_SPARE = 0.003
"""Kept beyond that, m."""
CROWDED = 0.3
"""Robots further apart than this need no barrier certificates, whose solver is coarse, m."""
_WITHIN = 1.0 - 1e-9
"""So far below the limit, or rounding takes wheels beyond it, which the laboratory counts."""


class Team:
    """What a folder holds: the team, and all that is known of the experiment."""

    def __init__(self, folder: Path) -> None:
        self.settings: dict[str, Any] = json.loads((folder / SETTINGS).read_text(encoding="utf-8"))
        with np.load(folder / ARRAYS, allow_pickle=False) as arrays:
            self._arrays = dict(arrays)
        self.robots = int(self.settings["robots"])
        self.arena = self._arena()
        team = self.settings
        spec = NetworkSpec(**team["network"])
        weights = {name: self._arrays[name] for name in spec.shapes}
        gains, in_place, laden = team["columns"]
        columns = Columns(None if gains is None else MoveGains(*gains), in_place, laden)
        networks = Networks(spec, weights, columns, ARRAYS)
        self.driven = RealTeam(
            self.arena,
            self.robots,
            ObservationLayout(**team["layout"]),
            # Rewards decide nothing once a policy has learned.
            RewardConfig(),
            PheromoneConfig(**team["pheromone"]),
            Player(networks.act, spec).act,
            team["keep_distance"],
        )

    def _arena(self) -> Arena:
        arrays, table = self._arrays, self.settings["arena"]
        field = {name: arrays[f"distances.{name}"] for name in ("raster", "_last", "_table")}
        return Arena(
            name=table["name"],
            description="",
            file=SETTINGS,
            text="",
            zones=arrays["zones"],
            cell_size=table["cell_size"],
            walls=arrays["walls"],
            distances=DistanceField(**field, **table["distances"]),
            tunnel_length=table["tunnel_length"],
            capacity=self.robots,
            start_places=np.zeros((0, 2)),
            pellet_places=arrays["pellet_places"],
            robot=RobotSheet(**table["robot"]),
            pellets=PelletSheet(**table["pellets"]),
            timing=Timing(**table["timing"]),
            as_text=False,
        )


class Experiment:
    """Gives velocities for poses, once in every turn, and keeps the score.

    Poses and velocities are as the laboratory has them: [3, robots] x m, y m, heading rad, from the middle of
    its floor, and [2, robots] m/s, rad/s.
    """

    def __init__(self, folder: str | Path) -> None:
        self.team = Team(Path(folder))
        settings, arena = self.team.settings, self.team.arena
        self.robots = self.team.robots
        self.turns = round(settings["seconds"] / TURN)
        """How long the experiment is."""
        self.starts: Floats = np.array(settings["starts"], np.float64).T
        """[3, robots] poses to begin at."""
        self.apart = float(settings["apart"])
        """Least distance of centres that barrier certificates are to keep, m; 0 for none."""
        self.origin = np.array([*settings["origin"], 0.0])
        """Where the corner of the map lies on the floor, m, and how it is turned."""
        self.floor = VirtualFloor(arena, self.robots, settings["seed"], self.apart)
        self.closest = np.inf
        """Least distance of two robots so far, as the laboratory checks it, m."""
        self.crowded = False
        """Whether two robots are within `CROWDED` in this turn."""
        self.deliveries: list[tuple[float, int]] = []
        """Time, s, and number of pellets so far, of each decision that brought some."""
        self._control_turns = round(arena.timing.control_period / TURN)
        self._decision_turns = self._control_turns * arena.timing.control_steps
        self._turn = 0
        self._twist = np.zeros((2, self.robots))

    @property
    def decided(self) -> bool:
        """Whether the last turn began a decision: then marks, pellets and score may have changed."""
        return (self._turn - 1) % self._decision_turns == 0

    def step(self, poses: Floats) -> Floats:
        """Return the velocities for this turn's poses."""
        team, floor = self.team.driven, self.floor
        pose = np.ascontiguousarray(poses.T - self.origin)
        here = team.on_map(pose)
        team.place(pose, here)
        # A robot that is lost stands still, and for the others it is where it was seen last.
        known = team.pose
        closest = float(checked_distances(pose[here]).min(initial=np.inf))
        self.closest = min(self.closest, closest)
        self.crowded = closest < CROWDED
        floor.look(known)
        if self._turn % self._decision_turns == 0:
            self._decide(known, ~here)
        if self._turn % self._control_turns == 0:
            speed, rate = body_twist(self.team.arena.robot, team.wheel_speeds(~here))
            self._twist = np.stack([speed, rate])
        self._turn += 1
        velocities = self._twist.copy()
        velocities[:, ~here] = 0.0
        # Whoever would drive into a wall turns on the spot. Barrier certificates come after, and may push
        # robots into one: walls are but light.
        velocities[0, floor.stopped_by_walls(known, velocities[0], TURN)] = 0.0
        return velocities

    def limited(self, velocities: Floats) -> Floats:
        """Return this turn's `velocities`, which others may have changed, as they can be obeyed.

        Beyond the wheels' limits both numbers are scaled: robots then move in the same direction. Where they
        are to be kept apart and two of them would come nearer than the laboratory allows, both stand still.
        """
        sheet = self.team.arena.robot
        fastest = np.abs(wheel_speeds_for(sheet, *velocities)).max(axis=1)
        limit = sheet.max_wheel_speed * _WITHIN
        slowed = velocities * (limit / np.maximum(fastest, limit))
        return self._held_apart(slowed) if self.apart else slowed

    def _held_apart(self, velocities: Floats) -> Floats:
        """Stop pairs that would come too near, and whoever comes too near to a robot that was stopped so."""
        pose = self.team.driven.pose
        now = checked_distances(pose)
        kept = velocities.copy()
        for _ in range(self.robots):
            speed, rate = kept
            heading = pose[:, 2]
            moved = np.stack([speed * np.cos(heading), speed * np.sin(heading), rate], axis=-1)
            then = checked_distances(pose + TURN * moved)
            too_near = ((then < LEAST_APART + _SPARE) & (then < now)).any(axis=1)
            if not too_near.any():
                break
            kept[:, too_near] = 0.0
        return kept

    def result(self) -> dict[str, Any]:
        """Return the score, to be written as JSON."""
        delivered = self.floor.delivered
        return {
            "policy": self.team.settings["policy"],
            "seconds": self._turn * TURN,
            "delivered": int(delivered.sum()),
            "delivered_of_robot": delivered.tolist(),
            "deliveries": self.deliveries,
            "closest": None if self.robots == 1 else float(self.closest),
        }

    def _decide(self, known: Floats, lost: NDArray[np.bool_]) -> None:
        team, floor = self.team.driven, self.floor
        time = self._turn * TURN
        if self._turn:
            before = floor.delivered.sum()
            floor.act(known, np.where(lost, np.int8(0), team.gripper))
            if floor.delivered.sum() > before:
                self.deliveries.append((time, int(floor.delivered.sum())))
        decision = self._turn // self._decision_turns
        team.decide(floor.readings(known, time), lost, decision, anew=self._turn == 0)
        floor.begin()
