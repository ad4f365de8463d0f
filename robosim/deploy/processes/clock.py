"""The world's clock as the other processes follow it."""

from __future__ import annotations

import math

from robosim.deploy.link.mail import Letter
from robosim.deploy.link.messages import NOBODY, Clock, Stage
from robosim.deploy.link.streams import Stream
from robosim.deploy.processes.times import GONE, scale
from robosim.errors import InputError


class WorldClock:
    """Follows one world; another is followed only when the first has been silent for a while."""

    def __init__(self, setup: int, robots: int, who: str) -> None:
        self._setup = setup
        self._robots = robots
        self._who = who
        self._stream = Stream()
        self.latest: Clock | None = None
        """None while no world has been heard."""
        self.at = -math.inf
        """When the latest arrived, monotonic, s."""

    @property
    def world(self) -> int:
        """Instance of the world that is followed, or `NOBODY`."""
        return self._stream.instance

    @property
    def stage(self) -> Stage:
        return Stage.WAITING if self.latest is None else self.latest.stage

    @property
    def speed(self) -> float:
        """World seconds in a second; 0 for as fast as all answer."""
        return 1.0 if self.latest is None else self.latest.speed

    @property
    def scale(self) -> float:
        """World seconds that limits let pass in a second."""
        return scale(self.speed)

    @property
    def service(self) -> int:
        return NOBODY if self.latest is None else self.latest.service

    def driver(self, robot: int) -> int:
        """Return the instance whose commands the world obeys for a robot."""
        return NOBODY if self.latest is None else self.latest.drivers[robot]

    def silent(self, now: float) -> float:
        """Return for how long no world has been heard, s of the wall clock."""
        return self._stream.silent(now)

    def take(self, letter: Letter) -> str:
        """Follow a `Clock`; return why it is dropped, or nothing.

        InputError if the world plays something else than this process was started for.
        """
        clock = letter.message
        assert isinstance(clock, Clock)  # noqa: S101  the mail has checked it
        another = letter.header.instance != self.world
        if another and (self.world == NOBODY or self.silent(letter.at) > GONE):
            if clock.setup != self._setup or len(clock.drivers) != self._robots:
                raise InputError(
                    f"{self._who}: the world plays another arena, team or pheromones than this process was "
                    "started with; give all processes the same POLICY, --arena and --robots."
                )
            self._stream.bind(letter.header.instance)
        dropped = self._stream.admit(letter.header, letter.at)
        if not dropped:
            self.latest, self.at = clock, letter.at
        return dropped
