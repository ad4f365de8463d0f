"""`robosim deploy world`: plays reality, in real or faster time, for robots that are processes."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from robosim.arena.model import Arena
from robosim.deploy.controller import Command
from robosim.deploy.link.lines import Lines
from robosim.deploy.link.mail import Letter, Mail, Token
from robosim.deploy.link.messages import (
    NO_POSE,
    NOBODY,
    Body,
    Clock,
    Deposit,
    Field,
    Order,
    Pose,
    Rest,
    Stage,
    WheelCommand,
)
from robosim.deploy.link.session import Link
from robosim.deploy.link.streams import FOREIGN, Stream
from robosim.deploy.processes.hold import TeamHold
from robosim.deploy.processes.stopping import Ending
from robosim.deploy.processes.times import HEARTBEAT, STALE, scale
from robosim.deploy.readings import Readings
from robosim.discretise.cells import Grid
from robosim.episodes.frame import Frame
from robosim.robot.drivers import STOP
from robosim.world.contacts import Contacts
from robosim.world.state import Gripper, WorldState

AS_FAST_AS_ALL_ANSWER = 0.0
"""In place of a speed."""
PROGRESS = 10.0
"""s of the wall clock between two lines that say how far the run is."""
_BEHIND = 0.2
"""s of the wall clock by which the world may lag behind its time before it gives that time up."""


class Played(Protocol):
    """The world inside an engine, for the picture."""

    @property
    def state(self) -> WorldState: ...

    @property
    def contacts(self) -> Contacts: ...


class Engine(Protocol):
    """Something that moves as wheels are commanded: `robosim.deploy.simulated.SimulatedRobots` is one."""

    arena: Arena

    @property
    def world(self) -> Played: ...

    @property
    def now(self) -> float: ...

    def readings(self) -> Readings: ...

    def obey(self, command: Command) -> None: ...


class Ran(NamedTuple):
    """What came of a run."""

    decisions: int
    delivered: list[int]
    """[robots] pellets."""
    wall: float
    """s from the first period to the last."""
    stopped: list[int]
    """[robots] control periods in which the watchdog held a robot."""
    dropped: dict[str, int]
    """Messages that were not believed, for each key and reason."""
    lost: int
    """Wheel commands that were sent and have not come."""
    trajectory: str
    """SHA-256 of all poses after each decision, float64 [robots, 3]: equal runs have equal ones."""


class WorldProcess:
    """Tells robots where they are, and moves them as their own processes command, and nobody else."""

    def __init__(
        self,
        engine: Engine,
        setup: int,
        link: Link,
        lines: Lines,
        *,
        speed: float,
        tracker_rate: float | None = None,
        needs_map: bool = True,
        on_frame: Callable[[Frame], None] | None = None,
    ) -> None:
        """`speed` is world seconds in a second, or `AS_FAST_AS_ALL_ANSWER`.

        Poses are published `tracker_rate` times in a second of the world, or in every control period.
        `on_frame` is called with the picture of each decision.
        """
        self._engine, self._setup = engine, setup
        self._link, self._lines = link, lines
        self.robots = len(engine.readings().time)
        self._mail = Mail(link, lines, self.robots)
        self._speed = speed
        self._scale = scale(speed)
        self._timing = engine.arena.timing
        rate = tracker_rate or np.inf
        self._tracker_period = max(1.0 / rate, self._timing.control_period)
        self._tracked = -1
        self._shown_at = 0.0
        self._needs_map = needs_map
        self._on_frame = on_frame
        self._drivers = [NOBODY] * self.robots
        self._alive: list[list[int]] = [[] for _ in range(self.robots)]
        self._services: list[int] = []
        self._commands = [Stream() for _ in range(self.robots)]
        self._latest = [WheelCommand(NO_POSE, 0.0, 0.0, int(Gripper.KEEP)) for _ in range(self.robots)]
        self._awaited = [True] * self.robots
        self._held = [""] * self.robots
        self._hold = TeamHold()
        self._deposit_streams = [Stream() for _ in range(self.robots)]
        self._mode = np.zeros(self.robots, np.uint8)
        self._action = np.full(self.robots, STOP)
        self._field_stream = Stream()
        arena = engine.arena
        self._grid = Grid(arena, margin=1)
        self._occupancy = np.zeros((arena.rows, arena.columns))
        self._delivered = np.zeros(self.robots, np.int64)
        self._stopped = [0] * self.robots
        self._behind = 0.0
        self._trajectory = hashlib.sha256()

    def run(self, decisions: int, ending: Ending, patience: float) -> Ran:
        """Play so many decisions, or until the process is asked to end.

        Robots and service are waited for, for up to `patience` s; then the run begins with those who came.
        """
        link = self._link
        for key in ("order", "wheels/*", *(("deposit/*", "field") if self._on_frame else ())):
            link.hear(key)
        link.watch("alive/**")
        self._gather(ending, patience)
        began = said = time.monotonic()
        due = began
        steps = self._timing.control_steps
        period = 0
        self._picture(0)
        while period < decisions * steps and not ending.asked:
            self._tell(Stage.RUNNING)
            due = self._wait(due + self._timing.control_period / self._scale)
            self._engine.obey(self._command())
            period += 1
            if period % steps == 0:
                state = self._engine.world.state
                self._delivered += state.deliveries[0]
                self._trajectory.update(state.pose[0].tobytes())
                self._picture(period // steps)
            now = time.monotonic()
            if now - said >= PROGRESS:
                self._say_progress(now - began)
                said = now
        wall = time.monotonic() - began
        self._end()
        self._say_progress(wall)
        self._lines.sum_up()
        return Ran(
            decisions=period // steps,
            delivered=self._delivered.tolist(),
            wall=wall,
            stopped=self._stopped,
            dropped=dict(self._lines.dropped),
            lost=sum(stream.lost for stream in self._commands),
            trajectory=self._trajectory.hexdigest(),
        )

    def _gather(self, ending: Ending, patience: float) -> None:
        """Wait until everybody is there, with a clock that stands."""
        self._lines.say(f"waiting for {self.robots} robots{' and the pheromone service' * self._needs_map}")
        began = time.monotonic()
        while not ending.asked:
            self._pump(HEARTBEAT)
            self._tell(Stage.WAITING)
            now = time.monotonic()
            missing = [f"robot {robot}" for robot in range(self.robots) if not self._hears(robot, now)]
            missing += ["pheromones"] * (self._needs_map and not self._services)
            if not missing:
                self._lines.say("all are there")
                break
            if now - began > patience:
                self._lines.say(f"begins without {', '.join(missing)}, after {patience:g} s")
                break

    def _hears(self, robot: int, now: float) -> bool:
        """Return whether the process that drives a robot is there, and speaks."""
        return self._drivers[robot] != NOBODY and self._commands[robot].silent(now) < STALE

    def _end(self) -> None:
        """Say that the run is over, often enough for everybody to hear it."""
        for _ in range(5):
            self._publish_clock(Stage.OVER)
            self._pump_until(time.monotonic() + HEARTBEAT / 2)

    def _say_progress(self, wall: float) -> None:
        now = self._engine.now
        behind = f", {self._behind:.1f} s behind its time" if self._behind else ""
        self._lines.say(
            f"{now:.0f} s in {wall:.0f} s of the wall clock{behind}: "
            f"{int(self._delivered.sum())} pellets, by robot {self._delivered.tolist()}"
        )

    def _tell(self, stage: Stage) -> None:
        """Publish the clock, what each robot feels, and, at the tracker's rate, where all are."""
        readings, link = self._engine.readings(), self._link
        now = self._engine.now
        for robot in range(self.robots):
            place = readings.pellet[robot]
            known = bool(np.isfinite(place).all())
            touched = readings.touched[:, robot].tolist()
            body = Body(
                now,
                laden=bool(readings.laden[robot]),
                at_pellet=bool(readings.at_pellet[robot]),
                touched=(touched[0], touched[1], touched[2]),
                pellet=(float(place[0]), float(place[1])) if known else None,
            )
            link.send(f"body/{robot}", body, robot)
        frame = int(now / self._tracker_period + 1e-6)
        if frame > self._tracked or stage == Stage.WAITING:
            self._tracked = frame if stage == Stage.RUNNING else self._tracked
            for robot in range(self.robots):
                x, y, heading = readings.pose[robot].tolist()
                age = max(now - float(readings.time[robot]), 0.0)
                link.send(f"pose/{robot}", Pose(now, x, y, heading, age), robot)
            self._shown_at = now
        self._publish_clock(stage)

    def _publish_clock(self, stage: Stage) -> None:
        service = self._services[0] if self._services else NOBODY
        hold = self._hold
        clock = Clock(
            *(self._setup, self._engine.now, self._speed, stage, service, tuple(self._drivers)),
            *(hold.hold, hold.released, self._rest(), hold.reason),
        )
        self._link.send("clock", clock)

    def _rest(self) -> tuple[Rest, ...]:
        """Return what robots have said of themselves while all are held, [robots]."""
        if self._hold.hold == NOBODY:
            return ()
        now = time.monotonic()
        return tuple(
            command.rest if command.hold == self._hold.hold and self._hears(robot, now) else Rest.UNKNOWN
            for robot, command in enumerate(self._latest)
        )

    def _wait(self, due: float) -> float:
        """Let a control period pass, in which commands arrive; return when the next begins, monotonic."""
        if self._speed == AS_FAST_AS_ALL_ANSWER:
            self._wait_for_answers()
            return time.monotonic()
        while due - time.monotonic() > HEARTBEAT:
            # A slow world is not a silent one: whoever orders a stop hears of it by the clock.
            self._pump_until(time.monotonic() + HEARTBEAT)
            self._publish_clock(Stage.RUNNING)
        self._pump_until(due)
        self._pump(0.0)
        late = time.monotonic() - due
        if late > _BEHIND:
            # Time that is lost is not made up for: robots could not follow a world that hurries.
            self._behind += late
            due += late
        return due

    def _wait_for_answers(self) -> None:
        """Wait until all whose commands are obeyed have answered the newest poses; they have `STALE` s."""
        limit = time.monotonic() + STALE
        while True:
            missing = [
                robot
                for robot in range(self.robots)
                if self._drivers[robot] != NOBODY
                and self._awaited[robot]
                and self._latest[robot].time < self._shown_at - 1e-9
            ]
            left = limit - time.monotonic()
            if not missing:
                return
            if left <= 0.0:
                # Not waited for again until they answer.
                for robot in missing:
                    self._awaited[robot] = False
                return
            self._pump(left)

    def _command(self) -> Command:
        """Return what the robots are commanded to do; whoever has been silent for too long stands."""
        now = time.monotonic()
        speeds = np.zeros((self.robots, 2))
        gripper = np.full(self.robots, Gripper.KEEP, np.int8)
        for robot, command in enumerate(self._latest):
            silent = self._commands[robot].age(now) * self._scale
            reason = "no process drives it" if self._drivers[robot] == NOBODY else ""
            if silent > STALE:
                reason = reason or "its process is silent"
            if self._speed == AS_FAST_AS_ALL_ANSWER and not self._awaited[robot]:
                reason = reason or "its process does not answer"
            if reason != self._held[robot]:
                self._lines.say(f"robot {robot} {f'is held: {reason}' if reason else 'goes on'}")
                self._held[robot] = reason
            if reason:
                self._stopped[robot] += 1
            elif self._hold.hold == NOBODY:
                speeds[robot] = command.left, command.right
                gripper[robot] = command.gripper
        return Command(speeds, gripper, tuple(self._held), np.zeros(self.robots, np.bool_), None)

    def _pump_until(self, due: float) -> None:
        """Take in mail until then, monotonic, s: any message ends a single wait for it."""
        while (left := due - time.monotonic()) > 0.0:
            self._pump(left)

    def _pump(self, timeout: float) -> None:
        for item in self._mail.take(timeout):
            if isinstance(item, Token):
                self._meet(item)
            else:
                dropped = self._take(item)
                if dropped:
                    self._lines.drop(item.key, dropped)

    def _take(self, letter: Letter) -> str:
        """Take in a message; return why it is dropped, or nothing."""
        robot, message = letter.header.robot, letter.message
        if isinstance(message, WheelCommand):
            if self._drivers[robot] == NOBODY:
                return FOREIGN
            dropped = self._commands[robot].admit(letter.header, letter.at)
            if not dropped:
                self._latest[robot] = message
                self._awaited[robot] = True
                self._say(self._hold.heard(robot, message.hold))
            return dropped
        if isinstance(message, Order):
            dropped, news = self._hold.take(letter.header.instance, message)
            self._say(news)
            return dropped
        if isinstance(message, Deposit):
            self._deposit_streams[robot].bind(self._drivers[robot])
            dropped = self._deposit_streams[robot].admit(letter.header, letter.at)
            if not dropped and message.marks:
                self._mode[robot], self._action[robot] = message.mode, message.action
            return dropped
        if isinstance(message, Field):
            self._field_stream.bind(self._services[0] if self._services else NOBODY)
            dropped = self._field_stream.admit(letter.header, letter.at)
            if not dropped and message.occupancy.shape == self._occupancy.shape:
                self._occupancy = message.occupancy.astype(np.float64)
            return dropped
        return "of a kind that the world does not take"

    def _say(self, news: str) -> None:
        if news:
            self._lines.say(news)

    def _meet(self, token: Token) -> None:
        """Take note of a process that has come or gone; the first of a name is obeyed as long as it lives."""
        of_robot = token.role == "robot"
        who = f"robot {token.robot}" if of_robot else "the pheromone service"
        alive = self._alive[token.robot] if of_robot else self._services
        if token.there and token.instance not in alive:
            alive.append(token.instance)
            if len(alive) > 1:
                self._lines.say(f"another process calls itself {who}: it is not listened to")
        elif not token.there and token.instance in alive:
            alive.remove(token.instance)
        driver = alive[0] if alive else NOBODY
        if not of_robot:
            self._lines.say(f"{who} is {'there' if driver else 'gone'}")
        elif driver != self._drivers[token.robot]:
            self._drivers[token.robot] = driver
            self._commands[token.robot].bind(driver)
            self._awaited[token.robot] = True
            self._lines.say(f"{who} is {f'driven by process {driver:x}' if driver else 'driven by nobody'}")

    def _picture(self, step: int) -> None:
        if self._on_frame is None:
            return
        world, state = self._engine.world, self._engine.world.state
        cells = self._grid.flat_index(self._grid.cell_coordinates(state.pose[..., :2]))
        self._on_frame(
            Frame(
                step=step,
                time=step * self._timing.decision_period,
                pose=state.pose[0],
                mode=self._mode,
                laden=state.held[0] >= 0,
                action=self._action,
                reward=np.full(self.robots, np.nan, np.float32),
                pellets=state.pellets[0],
                pellet_status=state.pellet_status[0],
                delivered=self._delivered.copy(),
                energy=np.zeros(self.robots),
                closest=np.full(self.robots, np.inf),
                density=float(self._grid.tunnel_density(cells)[0]),
                pheromone=self._occupancy,
                contacts=world.contacts,
            )
        )
