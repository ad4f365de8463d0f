"""`robosim deploy robot`: a process that drives one robot."""

from __future__ import annotations

import math
import time

import numpy as np

from robosim.arena.model import Arena
from robosim.deploy.controller import SETTLE, Chooser, Controller
from robosim.deploy.link.lines import Lines
from robosim.deploy.link.mail import Letter, Mail
from robosim.deploy.link.messages import (
    NO_POSE,
    NOBODY,
    Body,
    Clock,
    Deposit,
    Pose,
    Reading,
    Rest,
    Stage,
    WheelCommand,
)
from robosim.deploy.link.session import Link
from robosim.deploy.link.setup import setup_number
from robosim.deploy.link.streams import Stream
from robosim.deploy.log import DecisionLog
from robosim.deploy.processes.clock import WorldClock
from robosim.deploy.processes.hold import RobotHold
from robosim.deploy.processes.remote_map import RemoteMap
from robosim.deploy.processes.stopping import Ending
from robosim.deploy.processes.times import HEARTBEAT, MAP_STALE, STALE, TAKEOVER, frame_patience, patience
from robosim.deploy.readings import NOTHING, Floats, Readings, of_one_robot
from robosim.envs.config import EnvConfig
from robosim.errors import InputError
from robosim.world.state import Gripper

_STAND = (0.0, 0.0, int(Gripper.KEEP))


class RobotProcess:
    """Drives one robot by the team's policy, from its own sensors, the tracker's poses and the shared map."""

    def __init__(
        self,
        policy: Chooser,
        robot: int,
        config: EnvConfig,
        arena: Arena,
        link: Link,
        lines: Lines,
        name: str = "policy",
        log: DecisionLog | None = None,
    ) -> None:
        """`log` takes every control period in which the robot sees itself.

        InputError, in one sentence, for a policy that does not fit, or that needs all robots' eyes.
        """
        if policy.card.network.input == "team":
            raise InputError(
                f"policy {name} chooses for the whole team from what all robots observe, so robots cannot "
                "run it by themselves; drive them by one robosim.deploy.Controller."
            )
        self._robot = robot
        self._link, self._lines = link, lines
        self._mail = Mail(link, lines, config.robots)
        self._memory = RemoteMap(arena, config.pheromone, robot, self._exchange)
        self._controller = Controller(
            policy, config.robots, arena, max_age=STALE, name=name, memory=self._memory, log=log
        )
        self._log = log
        self._timing = arena.timing
        layout = self._controller.layout
        self._needs_map = layout.patch or layout.density
        # Whoever observes which cells around it are free, or keeps a distance, sees others by the tracker.
        sees_others = layout.encoding == "expanded" and (layout.neighbours or layout.own_frame)
        self._needs_others = sees_others or config.keep_distance is not None
        self._clock = WorldClock(setup_number(self._controller.config), config.robots, f"robot {robot}")
        self._world = NOBODY
        self._poses = [Stream() for _ in range(config.robots)]
        self._pose = np.full((config.robots, 3), np.nan)
        self._pose_times = np.full(config.robots, NO_POSE)
        self._pose_ages = np.zeros(config.robots)
        self._pose_time = NO_POSE
        self._body_stream = Stream()
        self._body = Body(0.0, laden=False, at_pellet=False, touched=(False, False, False), pellet=None)
        self._reading_stream = Stream()
        self._reading: Reading | None = None
        self._map_since = time.monotonic()
        self._maps: set[int] = set()
        self._period = NOTHING
        self._fresh = False
        self._fresh_at = 0.0
        self._answered = NO_POSE
        self._command = _STAND
        self._hold = RobotHold()
        self._held_at = math.inf
        self._rest = Rest.UNKNOWN
        self._sent_at = 0.0
        self._stopped = ""
        self.decisions = self.unanswered = self.early = 0
        self.stops: dict[str, int] = {}
        """How often the robot was stopped, for each kind of reason."""

    @property
    def lost(self) -> int:
        """Messages that were sent to this robot and have not come."""
        return sum(stream.lost for stream in (*self._poses, self._body_stream, self._reading_stream))

    def run(self, ending: Ending, patience_s: float) -> None:
        """Drive until the world ends or the process is asked to.

        InputError when no world is heard within `patience_s`, or another process drives this robot.
        """
        link, robot = self._link, self._robot
        for key in ("clock", f"body/{robot}", "pose/*" if self._needs_others else f"pose/{robot}"):
            link.hear(key)
        if self._needs_map:
            link.hear(f"reading/{robot}")
            link.watch("alive/pheromones/*")
        self._join(ending, patience_s)
        while not ending.asked and self._clock.stage != Stage.OVER:
            self._pump(self._until_due())
            self._require_own()
            now = time.monotonic()
            if self._fresh and self._clock.stage == Stage.RUNNING and self._until_due() <= 0.0:
                self._drive(now)
            elif now - self._sent_at >= self._heartbeat():
                self._repeat(now)
        self._send(_STAND, time.monotonic())
        why = "asked to end" if ending.asked else "the world has ended"
        self._lines.say(
            f"ends: {why}; {self.decisions} decisions, {self.unanswered} without a reading in time; "
            f"{self.lost} messages lost on the way, {self.early} periods begun before all was heard; "
            f"stopped {self.stops or 'never'}"
        )
        if self._log is not None and self._log.failed:
            self._lines.say(self._log.failed)
        self._lines.sum_up()

    def _heartbeat(self) -> float:
        """Return after how long the last command is said again, s: in a fast world limits are shorter."""
        return HEARTBEAT / max(self._clock.scale, 1.0)

    def _until_due(self) -> float:
        """Return how long to wait for mail, s: all that is said of one moment may come in any order."""
        if not self._fresh:
            return self._heartbeat()
        if self._heard_all():
            return 0.0
        waits = frame_patience(self._timing.control_period, self._clock.speed)
        return max(self._fresh_at + waits - time.monotonic(), 0.0)

    def _heard_all(self) -> bool:
        """Return whether all has come that belongs to the robot's newest pose."""
        others = not self._needs_others or bool((self._pose_times >= self._pose_time).all())
        return others and self._body.time >= self._pose_time

    def _join(self, ending: Ending, patience_s: float) -> None:
        """Wait for the world, and for being the one whose commands it obeys."""
        began = time.monotonic()
        robot, link = self._robot, self._link
        self._lines.say("waiting for the world")
        while self._clock.latest is None and not ending.asked:
            self._pump(HEARTBEAT)
            if time.monotonic() - began > patience_s:
                raise InputError(f"robot {robot}: no world is heard, after {patience_s:g} s; start it first.")
        link.appear(f"alive/robot/{robot}/{link.instance:x}")
        began = time.monotonic()
        while self._clock.driver(robot) != link.instance and not ending.asked:
            self._pump(HEARTBEAT)
            if time.monotonic() - began > TAKEOVER:
                self._require_own()
                raise InputError(f"robot {robot}: the world does not take note of this process.")
        self._map_since = time.monotonic()
        self._lines.say("drives")

    def _require_own(self) -> None:
        """Raise InputError if the world obeys another process under this robot's name."""
        if self._clock.driver(self._robot) not in (NOBODY, self._link.instance):
            self._send(_STAND, time.monotonic())
            raise InputError(
                f"robot {self._robot}: another process drives this robot; end it before another one is "
                "started."
            )

    def _pump(self, timeout: float) -> None:
        for item in self._mail.take(timeout):
            if isinstance(item, Letter):
                dropped = self._take(item)
                if dropped:
                    self._lines.drop(item.key, dropped)
            elif item.role == "pheromones":
                (self._maps.add if item.there else self._maps.discard)(item.instance)

    def _take(self, letter: Letter) -> str:
        """Take in a message; return why it is dropped, or nothing."""
        header, message = letter.header, letter.message
        if isinstance(message, Clock):
            dropped = self._clock.take(letter)
            if not dropped and self._clock.world != self._world:
                self._begin(self._clock.world)
            if not dropped:
                self._follow_hold(message, letter.at)
            return dropped
        if self._world == NOBODY:
            return ""  # Too early: until the clock is heard, nobody is believed.
        if isinstance(message, Pose):
            return self._take_pose(letter, message)
        if isinstance(message, Body):
            self._body_stream.bind(self._world)
            dropped = self._body_stream.admit(header, letter.at)
            if not dropped:
                self._body = message
            return dropped
        if isinstance(message, Reading):
            self._reading_stream.bind(self._clock.service)
            dropped = self._reading_stream.admit(header, letter.at)
            if not dropped:
                self._reading, self._map_since = message, letter.at
            return dropped
        return "of a kind that a robot does not take"

    def _follow_hold(self, clock: Clock, now: float) -> None:
        """Hold where an emergency stop is ordered, and go on where the one that holds is released."""
        changed = self._hold.take(clock.hold, clock.released)
        if changed is None:
            return
        self._held_at, self._rest = math.inf, Rest.HOLDS if changed else Rest.UNKNOWN
        if changed:
            reason = f"emergency stop: {clock.reason}"
            self._controller.emergency_stop(reason)
            self._stop(reason, now)
        else:
            self._controller.resume()
            self._lines.say("the emergency stop is released")

    def _watch_rest(self, now: float, *, unstopped: bool) -> None:
        """Note whether the robot, which is held, has come to rest; `now` is time of the world, s."""
        self._held_at = min(self._held_at, now)
        # So long it is looked at before it counts as standing.
        seen = now - self._held_at >= 2 * SETTLE
        rest = Rest.MOVES if unstopped else Rest.STANDS if seen else Rest.HOLDS
        if rest != self._rest and rest != Rest.HOLDS:
            stands = rest == Rest.STANDS
            self._lines.say("stands" if stands else "could not stop: it still moves, or is not seen")
        self._rest = rest

    def _begin(self, world: int) -> None:
        if self._world != NOBODY:
            self._lines.say("another run of the world: begins anew")
        self._world = world
        self._controller.reset()
        self._period = NOTHING
        self._fresh = False
        self._reading = None
        self._answered = NO_POSE
        self._pose[...] = np.nan
        self._pose_times[...] = self._pose_time = NO_POSE

    def _take_pose(self, letter: Letter, pose: Pose) -> str:
        other = letter.header.robot
        stream = self._poses[other]
        stream.bind(self._world)
        dropped = stream.admit(letter.header, letter.at)
        if dropped:
            return dropped
        self._pose_times[other], self._pose_ages[other] = pose.time, pose.age
        place = np.array([pose.x, pose.y, pose.heading])
        # Of others the last place on the map counts: a robot must not stop because another one is lost.
        if other == self._robot or self._on_map(place):
            self._pose[other] = place
        if other == self._robot:
            # A little later than exactly, since a time just below a border is meant to be on it.
            period = int(pose.time / self._timing.control_period + 1e-6)
            if period > self._period:
                self._fresh, self._fresh_at = True, letter.at
            self._period = max(period, self._period)
            self._pose_time = pose.time
        return ""

    def _on_map(self, pose: Floats) -> bool:
        width, height = self._controller.arena.size
        # Comparisons with NaN do not hold.
        return bool(0.0 <= pose[0] < width and 0.0 <= pose[1] < height)

    def _drive(self, now: float) -> None:
        """Take in the newest readings, decide if a decision begins, and command the wheels."""
        self.early += not self._heard_all()
        self._fresh = False
        self._answered = self._pose_time
        period = self._period
        self._memory.decision = decision = period // self._timing.control_steps
        readings, world_now = self._readings(now)
        if self._controller.decisions == 0 and not self._on_map(readings.pose[self._robot]):
            self._stop("no pose on the map yet", now)
            return
        command = self._controller.step(readings, world_now, period, self._held(now))
        robot = self._robot
        if command.actions is not None:
            self.decisions += 1
            if not self._needs_map and (deposit := self._memory.deposit()):
                # For the world's picture; whoever reads the map says it with every question.
                self._link.send(f"deposit/{robot}", deposit, robot)
        reason = command.stopped[robot]
        if self._hold.hold != NOBODY:
            self._watch_rest(world_now, unstopped=bool(command.unstopped[robot]))
        if reason:
            self._stop(reason, now)
            return
        self._go_on(decision)
        left, right = command.wheel_speeds[robot]
        self._command = float(left), float(right), int(command.gripper[robot])
        self._send(self._command, time.monotonic())

    def _repeat(self, now: float) -> None:
        """Say the last command again where nothing new is seen, or stop where that has been too long."""
        reason = self._blind(now) or self._held(now)
        if self._hold.hold != NOBODY:
            self._rest_unseen(now)
        if self._clock.stage != Stage.RUNNING:
            self._map_since = now
            # The world begins when all speak, so whoever cannot reach the map does not.
            if self._maps or not self._needs_map:
                self._send(_STAND, now)
        elif reason:
            self._stop(reason, now)
        else:
            self._send(self._command, now)

    def _rest_unseen(self, now: float) -> None:
        """Note whether the robot, which is held, is at rest where nothing new is seen of it."""
        if self._clock.stage == Stage.WAITING:
            # Before a run begins no wheel turns.
            self._rest = Rest.STANDS
        elif self._blind(now):
            self._watch_rest(self._pose_time, unstopped=True)

    def _readings(self, now: float) -> tuple[Readings, float]:
        """Return what is known of the team, and the time of the world."""
        scale = self._clock.scale
        age = scale * np.array([stream.age(now) for stream in self._poses])
        own = self._robot
        world_now = self._pose_time + age[own]
        age += self._pose_ages
        pose = self._pose.copy()
        # Where nothing is known of others, they are where they disturb nobody: with the robot itself.
        unseen = np.isnan(pose).any(axis=1) | ~np.isfinite(age)
        pose[unseen] = pose[own]
        age[unseen] = age[own]
        body = self._body
        readings = of_one_robot(
            own,
            world_now - age,
            pose,
            laden=body.laden,
            at_pellet=body.at_pellet,
            touched=body.touched,
            pellet=body.pellet,
        )
        return readings, world_now

    def _blind(self, now: float) -> str:
        """Return why the robot does not know where it is or what it holds, or nothing."""
        scale = self._clock.scale
        for what, stream in (("pose", self._poses[self._robot]), ("sensors", self._body_stream)):
            age = scale * stream.age(now)
            if age > STALE:
                return f"{what} of {_seconds(age)} ago"
        return ""

    def _held(self, now: float) -> str:
        """Return why the robot must not move although it knows where it is, or nothing."""
        age = self._clock.scale * self._body_stream.age(now)
        if age > STALE:
            return f"sensors of {_seconds(age)} ago"
        if self._clock.driver(self._robot) != self._link.instance:
            return "the world does not know this process"
        unread = self._clock.scale * (now - self._map_since)
        if self._needs_map and unread > MAP_STALE:
            return f"nothing read of the pheromone map for {_seconds(unread)}"
        return ""

    def _exchange(self, deposit: Deposit) -> Reading | None:
        """Send a deposit, and return the reading that answers it; None if it does not come in time."""
        self._link.send(f"deposit/{self._robot}", deposit, self._robot)
        waits_until = time.monotonic() + patience(self._timing.control_period, self._clock.speed)
        while True:
            reading = self._reading
            if reading is not None and reading.decision >= deposit.decision:
                return reading
            left = waits_until - time.monotonic()
            if left <= 0.0:
                break
            self._pump(left)
        self.unanswered += 1
        return self._reading

    def _stop(self, reason: str, now: float) -> None:
        kind = reason.split(" of ")[0].split(" for ")[0].split(" is ")[0].split(" at ")[0]
        if kind != self._stopped:
            self._lines.say(f"stopped: {reason}")
            self.stops[kind] = self.stops.get(kind, 0) + 1
            self._stopped = kind
        self._command = _STAND
        self._send(_STAND, now)

    def _go_on(self, decision: int) -> None:
        if self._stopped:
            self._lines.say(f"goes on, at decision {decision}")
            self._stopped = ""

    def _send(self, command: tuple[float, float, int], now: float) -> None:
        self._sent_at = now
        left, right, gripper = command
        answer = WheelCommand(self._answered, left, right, gripper, self._hold.hold, self._rest)
        self._link.send(f"wheels/{self._robot}", answer, self._robot)


def _seconds(age: float) -> str:
    return f"{age:.2f} s" if np.isfinite(age) else "any time"
