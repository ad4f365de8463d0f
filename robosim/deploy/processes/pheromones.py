"""`robosim deploy pheromones`: the shared map as a service."""

from __future__ import annotations

import math
import time
from pathlib import Path

from robosim.arena.model import Arena
from robosim.deploy.link.lines import Lines
from robosim.deploy.link.mail import Letter, Mail
from robosim.deploy.link.messages import NOBODY, Clock, Deposit, Field, Stage
from robosim.deploy.link.session import Link
from robosim.deploy.link.streams import FOREIGN, Stream
from robosim.deploy.processes.clock import WorldClock
from robosim.deploy.processes.shared_map import NOT_BEGUN, SharedMap
from robosim.deploy.processes.stopping import Ending
from robosim.deploy.processes.times import TAKEOVER, grace
from robosim.envs.config import EnvConfig
from robosim.errors import InputError

SAVE_EVERY = 1.0
"""s of the wall clock between two savings of the map."""
AHEAD = 2
"""Decisions that a robot may be ahead of the clock that the service has heard."""


class PheromoneService:
    """Takes the robots' deposits, ticks when all have come or time is up, and answers each."""

    def __init__(
        self, config: EnvConfig, arena: Arena, setup: int, link: Link, lines: Lines, file: Path | None = None
    ) -> None:
        """Go on with the map in `file`, if there is one, and keep it there from now on.

        InputError if the file holds anything else.
        """
        self._timing = arena.timing
        self._robots = range(config.robots)
        self._link, self._lines, self._file = link, lines, file
        self._mail = Mail(link, lines, config.robots)
        self.map = SharedMap(config, arena, setup)
        self._clock = WorldClock(setup, config.robots, "pheromones")
        self._streams = [Stream() for _ in self._robots]
        self._world = NOBODY
        self._clock_decision = NOT_BEGUN
        self._waits_since: float | None = None
        self._other_since = math.inf
        self._saved_at = time.monotonic()
        self._saved_decision = NOT_BEGUN
        self._unsaved = ""
        self.late = self.incomplete = self.ticks = 0
        if file is not None and file.exists():
            self._world = self.map.restore(file)
            lines.say(f"{file}: found the map of decision {self.map.decision}")

    @property
    def lost(self) -> int:
        """Deposits that were sent and have not come."""
        return sum(stream.lost for stream in self._streams)

    def run(self, ending: Ending) -> None:
        """Serve until the world ends or the process is asked to; InputError if it cannot go on."""
        link = self._link
        for key in ("clock", "deposit/*"):
            link.hear(key)
        link.appear(f"alive/pheromones/{link.instance:x}")
        self._lines.say("serving; waiting for the world")
        while not ending.asked and self._clock.stage != Stage.OVER:
            for item in self._mail.take(self._until_due()):
                if isinstance(item, Letter):
                    self._take(item)
            self._tick_if_due()
            self._save_if_due()
        self._save()
        self._lines.say(
            f"ends at decision {self.map.decision} after {self.ticks} ticks, of which {self.incomplete} "
            f"lacked a robot's deposit; {self.late} deposits came too late, {self.lost} got lost"
        )
        self._lines.sum_up()

    def _take(self, letter: Letter) -> None:
        dropped = ""
        if isinstance(letter.message, Clock):
            dropped = self._clock.take(letter)
            if not dropped:
                self._follow(letter.message)
        elif isinstance(letter.message, Deposit):
            dropped = self._take_deposit(letter, letter.message)
        if dropped:
            self._lines.drop(letter.key, dropped)

    def _follow(self, clock: Clock) -> None:
        if self._world != self._clock.world:
            self._begin(self._clock.world)
        self._other_since = min(self._other_since, self._clock.at)
        if clock.service in (NOBODY, self._link.instance):
            self._other_since = self._clock.at
        elif self._clock.at - self._other_since > TAKEOVER:
            raise InputError(
                "pheromones: another service has the team's map; end it before another one is started."
            )
        for robot, driver in enumerate(clock.drivers):
            if self._streams[robot].instance != driver:
                self._streams[robot].bind(driver)
                if driver == NOBODY:
                    self.map.forget(robot)
        if clock.stage == Stage.RUNNING:
            # A little later than exactly, since a time just below a border is meant to be on it.
            self._clock_decision = int(clock.time / self._timing.decision_period + 1e-6)

    def _begin(self, world: int) -> None:
        restored = self.map.decision
        if self._world != NOBODY or restored != NOT_BEGUN:
            self._lines.say("another run of the world: begins with an empty map")
            self.map.begin()
        self._world = world
        self._clock_decision = NOT_BEGUN

    def _take_deposit(self, letter: Letter, deposit: Deposit) -> str:
        robot = letter.header.robot
        stream = self._streams[robot]
        if stream.instance == NOBODY:
            return FOREIGN
        dropped = stream.admit(letter.header, letter.at)
        if dropped:
            return dropped
        if deposit.decision > self._clock_decision + AHEAD:
            return "ahead of the world's clock"
        late = self.map.late(deposit)
        dropped = self.map.deposit(robot, deposit)
        if late and not dropped:
            self.late += deposit.marks
            self._link.send(f"reading/{robot}", self.map.read(robot, deposit), robot)
        return dropped

    def _due(self) -> int:
        """Return the decision that is to be ticked next; that of the last tick if none is."""
        return max(self.map.next_decision, self._clock_decision, self.map.decision)

    def _until_due(self) -> float:
        """Return how long to wait for mail, s."""
        if self._waits_since is None:
            return SAVE_EVERY
        return max(self._waits_since + self._grace() - time.monotonic(), 0.0)

    def _grace(self) -> float:
        return grace(self._timing.control_period, self._clock.speed)

    def _tick_if_due(self) -> None:
        decision = self._due()
        if decision <= self.map.decision:
            return
        now = time.monotonic()
        # Since the first tick that is missing: others may become due meanwhile.
        self._waits_since = now if self._waits_since is None else self._waits_since
        driven = [robot for robot in self._robots if self._streams[robot].instance != NOBODY]
        complete = self.map.has_all(driven, decision)
        if not complete and now - self._waits_since < self._grace():
            return
        self._waits_since = None
        self.ticks += 1
        self.incomplete += not complete
        for robot, reading in self.map.tick(decision).items():
            self._link.send(f"reading/{robot}", reading, robot)
        self._link.send("field", Field(decision, self.map.occupancy))

    def _save_if_due(self) -> None:
        if time.monotonic() - self._saved_at >= SAVE_EVERY:
            self._save()

    def _save(self) -> None:
        self._saved_at = time.monotonic()
        if self._file is None or self.map.decision == self._saved_decision:
            return
        try:
            self.map.save(self._file, self._world)
        except InputError as error:
            # A full disk must not take the map from the robots.
            if str(error) != self._unsaved:
                self._lines.say(f"the map is not saved: {error}")
            self._unsaved = str(error)
            return
        self._unsaved = ""
        self._saved_decision = self.map.decision
