"""A controller's log worked through again: what its controller held while it wrote it.

Modes and pheromones are not in the log. They follow from the readings and the actions that are, by the code
that the controller runs; the log vouches for it by the SHA-256 of the observations of every decision.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robosim.arena import parse_arena
from robosim.deploy.log import Logged, LogHead, open_log
from robosim.deploy.team import RealTeam
from robosim.episodes.control_frame import ControlFrame
from robosim.errors import InputError, refused
from robosim.robot.drivers import CARDINAL_STEPS, STOP

LONGEST = 1e9
"""s from the first to any other line of a log, some thirty years."""


class Retrace:
    """Works through a log, a control period at a time."""

    def __init__(self, path: str | Path) -> None:
        """Read the log's first line; InputError for what is no log, or holds no arena."""
        self._path = Path(path)
        self.head: LogHead
        """Who drove, and what the controller was made of."""
        self.head, self._periods = open_log(path)
        config = self.head.env
        # As text alone: a stranger's file must not name a file of this machine.
        try:
            self.arena = parse_arena(config.arena, f"{path}: arena")
        except InputError as error:
            # An arena's mistakes are a line each; here nobody is going to mend them.
            raise InputError(str(error).partition("\n")[0]) from None
        self.decisions = 0
        """Worked through so far."""
        self.vouched = 0
        """Of these, decisions whose observations are those of the log to the last bit."""
        self.first_unlike: int | None = None
        """The first decision whose observations are not."""
        self._chosen: NDArray[np.int64] = np.empty(0, np.int64)
        self._target_place = np.full((config.robots, 2), np.nan)
        layout = config.layout_in(self.arena)
        try:
            self._team = RealTeam(
                self.arena,
                config.robots,
                layout,
                config.reward,
                config.pheromone,
                self._choose_as_logged,
                config.keep_distance,
            )
        except InputError as error:
            raise InputError(f"{path}: {error}") from None

    def frames(self) -> Iterator[ControlFrame]:
        """Yield what the controller knew and commanded in each control period.

        InputError for a line that no controller has written.
        """
        began: float | None = None
        number = 1
        for number, logged in enumerate(self._periods, 2):
            place = f"{self._path}: line {number}"
            began = logged.now if began is None else began
            if abs(logged.now - began) > LONGEST:
                raise refused(f"{place}: now", logged.now, f"within {LONGEST:g} s of the first line's")
            # Whatever a tracker said is in the log, and numbers without bounds may overflow.
            with np.errstate(over="ignore", invalid="ignore"):
                if number == 2 and not logged.begins:
                    raise InputError(f"{place}: no run begins with the first control period.")
                self._take(logged, place)
                frame = self._frame(logged, logged.now - began)
            yield frame
        if number == 1:
            raise InputError(f"{self._path}: holds no control period.")

    def _take(self, logged: Logged, place: str) -> None:
        """Do what the controller did in a period."""
        team, readings, begins = self._team, logged.readings, logged.begins
        on_map = team.on_map(readings.pose)
        if begins and not on_map.all():
            raise InputError(f"{place}: robot {int(np.argmin(on_map))} is not on the map as a run begins.")
        if begins and logged.actions is None:
            raise InputError(f"{place}: a run begins without a decision.")
        if logged.resumed and not begins:
            team.stand()
        team.place(readings.pose, on_map)
        stopped = np.array([bool(reason) for reason in logged.stopped])
        if logged.actions is not None:
            self._chosen = logged.actions
            observation = team.decide(readings, stopped, logged.period, anew=begins)
            # Added, as the controller does: the two zeros are one number.
            digest = hashlib.sha256((observation + np.float32(0.0)).tobytes()).hexdigest()
            self._compare(digest == logged.observation)
        # Drivers remember what they have commanded.
        team.wheel_speeds(stopped)

    def _choose_as_logged(self, observation: NDArray[np.float32], decision: int) -> NDArray[np.int64]:
        return self._chosen[None]

    def _compare(self, alike: bool) -> None:
        if alike:
            self.vouched += 1
        elif self.first_unlike is None:
            self.first_unlike = self.decisions
        self.decisions += 1

    def _frame(self, logged: Logged, time: float) -> ControlFrame:
        team, readings = self._team, logged.readings
        on_map = team.on_map(np.column_stack([readings.pellet, np.zeros(len(readings.pellet))]))
        own_map = self.head.map == "own"
        return ControlFrame(
            step=self.decisions - 1,
            time=time,
            decides=logged.actions is not None,
            begins=logged.begins,
            pose=team.pose,
            age=logged.now - readings.time,
            mode=team.shown_mode,
            laden=readings.laden,
            touched=readings.touched,
            pellet=np.where(on_map[:, None], readings.pellet, np.nan),
            pheromone=team.occupancy if own_map else None,
            action=team.actions,
            target=self._target(logged.actions),
            wheel_speeds=logged.wheel_speeds,
            gripper=logged.gripper,
            stopped=logged.stopped,
            unstopped=logged.unstopped,
            emergency=logged.emergency,
        )

    def _target(self, decided: NDArray[np.int64] | None) -> NDArray[np.float64]:
        """Return the middles of the cells that were chosen, from where robots were when they chose."""
        if decided is not None and self.head.env.actions == "cardinal":
            cell = self.arena.cell_size
            here = np.floor(self._team.pose[:, :2] / cell)
            self._target_place = (here + CARDINAL_STEPS[decided] + 0.5) * cell
        return np.where((self._team.actions == STOP)[:, None], np.nan, self._target_place)
