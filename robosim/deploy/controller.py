"""The controller that runs on a robot, or beside a team of them: from sensors to wheel speeds.

Modes, pheromones, observations and drivers are those of training, the same code: nothing is written anew for
real robots. It needs numpy, and none of what simulates or trains.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Arena
from robosim.control.card import PolicyCard
from robosim.control.learned import check_fit
from robosim.control.player import Player
from robosim.deploy.log import DecisionLog
from robosim.deploy.readings import Bools, Floats, Readings
from robosim.deploy.team import RealTeam
from robosim.discretise.pheromone import SharedMemory
from robosim.envs.config import env_config
from robosim.equality import EqualByValue
from robosim.errors import InputError, refused
from robosim.robot.kinematics import wrap_angle
from robosim.world.state import Gripper

MAX_AGE = 0.5
"""s; as long as a Robotarium's robot waits for commands before it pauses."""
SETTLE = 0.5
"""Time in which a robot must come to rest after an emergency stop, s."""
STILL_WITHIN, STILL_TURN = 0.01, 0.1
"""m and rad: a robot that has moved further since it should have come to rest has not stopped."""
NOT_BEGUN = -1
"""In place of the number of a decision, before the first."""


class Chooser(Protocol):
    """A policy: `robosim.control.policy.Policy`, or `robosim.deploy.runtime.OnnxPolicy`."""

    @property
    def card(self) -> PolicyCard: ...

    def act(
        self,
        observation: NDArray[np.float32],
        decision: int | None = None,
        retreats: NDArray[np.int64] | None = None,
    ) -> NDArray[np.int64]: ...


@dataclass(frozen=True, slots=True, eq=False)
class Command(EqualByValue):
    """What the robots are to do in the next control period."""

    wheel_speeds: Floats
    """[robots, 2] left and right, rad/s, within the data sheet; 0 for robots that are stopped."""
    gripper: NDArray[np.int8]
    """[robots] `Gripper`, to be done once in a decision, at its end; KEEP for robots that are stopped."""
    stopped: tuple[str, ...]
    """[robots] why a robot is stopped, in words; empty for those that are not."""
    unstopped: Bools
    """[robots] an emergency stop could not be seen to hold this robot: it still moves, or nobody sees it."""
    actions: NDArray[np.int64] | None
    """[robots] what has just been decided; None within a decision."""


class Controller:
    """Drives a team, or one robot of it, by a trained policy.

    All robots are worked out together, since they meet in the pheromone map. A computer for the whole team
    sends each robot its row of the command. A robot with a computer of its own calls the same code with the
    same tracker's poses, and obeys its own row.
    """

    def __init__(
        self,
        policy: Chooser,
        robots: int | None = None,
        arena: Arena | str | Path | None = None,
        *,
        max_age: float = MAX_AGE,
        log: DecisionLog | None = None,
        name: str = "policy",
        memory: SharedMemory | None = None,
    ) -> None:
        """Take a policy; `robots` and `arena` are by default those of its card.

        Readings older than `max_age` (s) stop a robot. `memory` is the pheromone map that is shared with
        others; without one the controller keeps its own. InputError, in one sentence that calls the policy
        `name`, for a team or an arena that it does not fit.
        """
        card = policy.card
        if not 0.0 < max_age < np.inf:
            raise refused("max_age", max_age, "a number of seconds above 0")
        # Real robots are bodies, wherever the policy learned.
        self.config, self.arena = env_config(card.env, arena=arena, robots=robots, world="physics")
        self.robots = self.config.robots
        self.layout = self.config.layout_in(self.arena)
        check_fit(card, self, name)
        self._max_age = max_age
        self._log = log
        self._team = RealTeam(
            self.arena,
            self.robots,
            self.layout,
            self.config.reward,
            self.config.pheromone,
            Player(policy.act, card.network).act,
            self.config.keep_distance,
            memory,
        )
        self._emergency = ""
        self._resumed = False
        """Since the last line of the log."""
        self._held_since: float | None = None
        self._rest: Floats | None = None
        self._observed = ""
        self._periods = 0
        self._decision = NOT_BEGUN
        if log is not None:
            log.begin(name, self.config, max_age, shared_map=memory is not None)

    @property
    def decisions(self) -> int:
        """Decisions taken since the last reset."""
        return -(-self._periods // self.arena.timing.control_steps)

    @property
    def mode(self) -> NDArray[np.uint8]:
        """[robots] `Mode` of each robot at the last decision, COLLISION overlaid."""
        return self._team.shown_mode

    @property
    def occupancy(self) -> Floats:
        """[rows, columns] occupancy of the pheromone map at the last decision, row 0 at the bottom."""
        return self._team.occupancy

    @property
    def emergency(self) -> str:
        """Why all robots are held; empty when they are not."""
        return self._emergency

    def reset(self) -> None:
        """Begin anew with the next readings: pheromones and all that is remembered are gone.

        An emergency stop stays.
        """
        self._periods = 0
        self._decision = NOT_BEGUN

    def step(self, readings: Readings, now: float, period: int | None = None, held: str = "") -> Command:
        """Return what to do from `now` (s) on; to be called once in every control period.

        Every so many periods a decision is taken. Periods are counted in calls, or are what `period` says,
        by which teams whose robots run by themselves decide at the same time. `held` is a reason of the
        caller's to stop all robots. InputError for arrays of the wrong shape, and for first
        readings in which a robot has no pose on the map; whatever else is wrong with a reading stops the
        robot, and says so.
        """
        readings.require_robots(self.robots)
        reasons = self._reasons(readings, now, held)
        stopped = np.array([bool(reason) for reason in reasons])
        period = self._periods if period is None else period
        decision = period // self.arena.timing.control_steps
        anew, begins = self._decision == NOT_BEGUN, decision != self._decision
        if begins:
            self._decide(readings, stopped, decision)
            if self._emergency and not stopped.all():
                # It came while the decision waited for the map.
                reasons, stopped = (self._emergency,) * self.robots, np.ones(self.robots, np.bool_)
                self._team.stand()
        self._periods, self._decision = period + 1, decision
        command = Command(
            wheel_speeds=self._team.wheel_speeds(stopped),
            gripper=np.where(stopped, np.int8(Gripper.KEEP), self._team.gripper),
            stopped=reasons,
            unstopped=self._unstopped(readings, now),
            actions=self._team.actions.copy() if begins else None,
        )
        if self._log is not None:
            observed = self._observed if begins else ""
            self._log.add(
                *(period, readings, now, command, self._emergency, observed),
                begins=anew,
                resumed=self._resumed,
            )
        self._resumed = False
        return command

    def emergency_stop(self, reason: str = "emergency stop") -> Command:
        """Hold all robots until `resume`; returns the command to send at once.

        Whether they came to rest is seen by the tracker: `unstopped` of the commands that follow tells who,
        half a second later, still moves or is not seen.
        """
        self._emergency = reason or "emergency stop"
        self._held_since = self._rest = None
        return Command(
            wheel_speeds=np.zeros((self.robots, 2)),
            gripper=np.full(self.robots, Gripper.KEEP, np.int8),
            stopped=(self._emergency,) * self.robots,
            unstopped=np.zeros(self.robots, np.bool_),
            actions=None,
        )

    def resume(self) -> None:
        """End an emergency stop; robots go on with the next decision."""
        self._emergency, self._resumed = "", True
        if self._decision != NOT_BEGUN:
            self._team.stand()

    def _reasons(self, readings: Readings, now: float, held: str) -> tuple[str, ...]:
        """Take in the poses that can be used; return why each robot must stop, or nothing."""
        pose = readings.pose
        width, height = self.arena.size
        seen = np.asarray(np.isfinite(pose).all(axis=1))
        on_map = self._team.on_map(pose)
        if self._decision == NOT_BEGUN and not on_map.all():
            robot = int(np.argmin(on_map))
            raise InputError(
                f"readings: pose of robot {robot} is {_shown(pose[robot])}, but must be on the map of "
                f"{width:g} x {height:g} m as a run begins."
            )
        self._team.place(pose, on_map)
        age = now - readings.time
        fresh = np.abs(age) <= self._max_age
        if self._emergency or held:
            return (self._emergency or held,) * self.robots
        return tuple(
            "no pose"
            if not seen[robot]
            else f"off the map at {_shown(pose[robot])}"
            if not on_map[robot]
            else ""
            if fresh[robot]
            else f"pose is {abs(age[robot]):.2f} s {'ahead' if age[robot] < 0.0 else 'old'}"
            for robot in range(self.robots)
        )

    def _decide(self, readings: Readings, stopped: Bools, decision: int) -> None:
        anew = self._decision == NOT_BEGUN
        observation = self._team.decide(readings, stopped, decision, anew=anew)
        # Added, since the two zeros are one number to whoever reads them.
        self._observed = hashlib.sha256((observation + np.float32(0.0)).tobytes()).hexdigest()

    def _unstopped(self, readings: Readings, now: float) -> Bools:
        """Return who cannot be seen to rest, once an emergency stop has had its time."""
        nobody = np.zeros(self.robots, np.bool_)
        if not self._emergency:
            return nobody
        if self._held_since is None:
            self._held_since = now
        if now - self._held_since < SETTLE:
            return nobody
        pose = np.where(np.isfinite(readings.pose), readings.pose, np.nan)
        self._rest = pose if self._rest is None else np.where(np.isnan(self._rest), pose, self._rest)
        apart = pose - self._rest
        near = np.hypot(apart[:, 0], apart[:, 1]) <= STILL_WITHIN
        near &= np.abs(wrap_angle(apart[:, 2])) <= STILL_TURN
        return ~(near & (np.abs(now - readings.time) <= self._max_age))


def _shown(pose: Floats) -> str:
    return f"({pose[0]:.3g}, {pose[1]:.3g})"
