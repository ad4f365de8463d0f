"""`robosim deploy`: a team of processes: robots, the pheromone service, and the world that they live in."""

from __future__ import annotations

import contextlib
import json
import shlex
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from robosim.cli.program import hint

if TYPE_CHECKING:
    from robosim.arena.model import Arena
    from robosim.control.policy import Policy
    from robosim.deploy.link.access import LinkConfig
    from robosim.deploy.link.disturbance import Disturbance
    from robosim.deploy.processes.operator import Operator
    from robosim.envs.config import EnvConfig
    from robosim.episodes.frame import Frame

WORLD_AT = "127.0.0.1:7447"
"""Where a world listens unless it is told otherwise."""
PATIENCE = 60.0
"""s of the wall clock for which processes wait for each other."""


@dataclass(frozen=True)
class _Common:
    policy: Annotated[str, tyro.conf.Positional]
    """Trained policy by name, or policy or run folder; all processes of a team are given the same."""
    arena: str | None = None
    """Arena by name, or the path of its file; by default the policy's own."""
    robots: int | None = None
    """Team size; by default the policy's own."""
    team: str = "team"
    """Name of the team: several may share a network."""
    world_at: Annotated[str, tyro.conf.arg(metavar="HOST:PORT")] = WORLD_AT
    """Where the world listens."""
    map_at: Annotated[str, tyro.conf.arg(metavar="HOST:PORT")] = "127.0.0.1:7448"
    """Where the pheromone service listens."""
    keys: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """Folder with certificates and keys, for TLS and access control; without one the link is open."""
    patience: float = PATIENCE
    """How long to wait for the others at the beginning, s."""
    loss: float = 0.0
    """To try a bad link: probability that a message which this process sends gets lost."""
    doubled: float = 0.0
    """To try a bad link: probability that one arrives twice."""
    delay: float = 0.0
    """To try a bad link: time that each takes, s of the wall clock."""
    jitter: float = 0.0
    """To try a bad link: further time, drawn evenly from 0 to this, s; later ones overtake."""
    link_seed: int = 0
    """Of what a bad link draws; each process draws by its own name, too."""

    def _link(self) -> tuple[LinkConfig, Disturbance]:
        from robosim.deploy.link.access import LinkConfig
        from robosim.deploy.link.disturbance import Disturbance
        from robosim.errors import refused

        if not 0.0 < self.patience <= 1e6:
            raise refused("--patience", self.patience, "a number of seconds above 0 and of at most 1e6")
        table = {
            "team": self.team,
            "world_at": self.world_at,
            "map_at": self.map_at,
            "keys": "" if self.keys is None else str(self.keys),
        }
        disturbed = {
            "loss": self.loss,
            "doubled": self.doubled,
            "delay": self.delay,
            "jitter": self.jitter,
            "disturbance_seed": self.link_seed,
        }
        return LinkConfig.from_table(table, "link"), Disturbance.from_table(disturbed, "link")

    def _team(self) -> tuple[Policy, EnvConfig, Arena]:
        from robosim.control.policy import load_policy
        from robosim.deploy.controller import Controller

        policy = load_policy(self.policy)
        # It knows what of the card real robots need, and refuses a team or an arena that does not fit.
        controller = Controller(policy, self.robots, self.arena, name=Path(self.policy).name)
        # As in an evaluation: how a policy learned does not change what it is tried on.
        config = controller.config.changed(pellet_gradient=0.0, profile=None, episode_steps=0)
        return policy, config, controller.arena


def _checked(text: str, seed: int, decisions: int | None) -> float:
    """Return the seconds of the world in a second that --speed asks for, `text`.

    InputError for none, and for a --seed or --decisions that a world does not take.
    """
    from robosim.deploy.processes.world import AS_FAST_AS_ALL_ANSWER
    from robosim.envs.config import MOST_STEPS
    from robosim.envs.vector import MAX_SEED
    from robosim.errors import refused, whole_number

    whole_number("--seed", seed, 0, MAX_SEED)
    if decisions is not None:
        whole_number("--decisions", decisions, 1, MOST_STEPS)
    if text == "max":
        return AS_FAST_AS_ALL_ANSWER
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0.01 <= speed <= 100.0:
        raise refused("--speed", text, "a number from 0.01 to 100, or max")
    return speed


@dataclass(frozen=True)
class World(_Common):
    """Play reality for a team: tell robots where they are, and move them as their processes command."""

    speed: Annotated[str, tyro.conf.arg(metavar="NUMBER|max")] = "1"
    """Seconds of the world in a second, or `max` for as fast as all robots answer."""
    decisions: int | None = None
    """Decisions to play; by default a whole episode."""
    seed: int = 0
    """Of where robots and pellets begin."""
    profile: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE.toml")] = None
    """What is random and wrong about robots and their tracker, by name or file (docs/noise.md); by default
    nothing. What it says of pheromones does not count: --delay, --loss and so on make a bad link to them."""
    engine: Literal["pymunk", "mujoco"] = "pymunk"
    """The physics that teams learn in, or the second one, in three dimensions."""
    tracker_rate: float | None = None
    """How often poses are published, in a second of the world; by default in every control period."""
    save: Annotated[Path | None, tyro.conf.arg(metavar="RUN.rrd")] = None
    """Record what happens, for the rerun viewer."""
    view: bool = False
    """Open the viewer, and show what happens as it does; with --save. Without a display only the file is
    written."""
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Write what came of the run."""

    def run(self) -> None:
        from robosim.deploy.link.lines import Lines
        from robosim.deploy.link.session import Link
        from robosim.deploy.link.setup import setup_number
        from robosim.deploy.processes.stopping import Ending
        from robosim.deploy.processes.world import WorldProcess
        from robosim.deploy.simulated import SimulatedRobots
        from robosim.envs.config import env_config
        from robosim.errors import InputError, refused
        from robosim.files import require_writable, write_whole

        speed = _checked(self.speed, self.seed, self.decisions)
        if self.tracker_rate is not None and not 0.1 <= self.tracker_rate <= 1e4:
            raise refused("--tracker-rate", self.tracker_rate, "a number from 0.1 to 10000")
        if self.view and self.save is None:
            raise InputError("--view shows what is recorded: it needs --save RUN.rrd.")
        if self.json is not None:
            require_writable(self.json)
        link_config, disturbance = self._link()
        _, config, arena = self._team()
        lines, layout = Lines("world"), config.layout_in(arena)
        noisy, _ = env_config(config, profile=self.profile)
        robots = SimulatedRobots(noisy, self.seed, engine=self.engine)
        decisions = self.decisions or arena.timing.episode_steps
        with (
            Ending() as ending,
            self._picture(arena, config.robots, lines.say) as on_frame,
            Link(
                "world",
                link_config,
                listen=link_config.world_at,
                robots=config.robots,
                disturbance=disturbance,
            ) as link,
        ):
            world = WorldProcess(
                robots,
                setup_number(config),
                link,
                lines,
                speed=speed,
                tracker_rate=self.tracker_rate,
                needs_map=layout.patch or layout.density,
                on_frame=on_frame,
            )
            ran = world.run(decisions, ending, self.patience)
        print(f"{ran.decisions} decisions, {sum(ran.delivered)} pellets, in {ran.wall:.1f} s")
        if self.json is not None:
            write_whole(self.json, json.dumps(ran._asdict(), indent=2) + "\n")

    @contextlib.contextmanager
    def _picture(
        self, arena: Arena, robots: int, say: Callable[[str], None]
    ) -> Iterator[Callable[[Frame], None] | None]:
        """Give what records a frame, if anything is to be recorded."""
        if self.save is None:
            yield None
            return
        from robosim.playback.live import live_recording

        about = {
            "policy": Path(self.policy).name,
            "driven by": "processes of their own",
            "seed": str(self.seed),
            "engine": self.engine,
            "profile": self.profile or "none",
            "rewards": "not worked out: nobody learns here",
        }
        kept = live_recording(
            self.save, arena, robots=robots, about=about, view=self.view, say=say, rewards=False
        )
        with kept as add:
            yield add
        say(f"{self.save}: open it with: {hint('view', self.save)}")


@dataclass(frozen=True)
class Robot(_Common):
    """Drive one robot of a team."""

    robot: int = 0
    """Which one, from 0."""
    log: Annotated[Path | None, tyro.conf.arg(metavar="FILE.jsonl")] = None
    """Write what came in and what went out in every control period to a new file; `robosim play` shows it."""

    def run(self) -> None:
        from robosim.deploy.link.access import robot_name
        from robosim.deploy.link.lines import Lines
        from robosim.deploy.link.session import Link
        from robosim.deploy.log import DecisionLog
        from robosim.deploy.processes.robot import RobotProcess
        from robosim.deploy.processes.stopping import Ending
        from robosim.errors import whole_number

        link_config, disturbance = self._link()
        policy, config, arena = self._team()
        whole_number("--robot", self.robot, 0, config.robots - 1)
        lines = Lines(f"robot {self.robot}")
        places = (link_config.world_at, link_config.map_at)
        log = None if self.log is None else DecisionLog(self.log, self.robot)
        with (
            contextlib.closing(log) if log else contextlib.nullcontext(),
            Ending() as ending,
            Link(
                robot_name(self.robot),
                link_config,
                connect=places,
                robots=config.robots,
                disturbance=disturbance,
            ) as link,
        ):
            name = Path(self.policy).name
            robot = RobotProcess(policy, self.robot, config, arena, link, lines, name, log)
            robot.run(ending, self.patience)


@dataclass(frozen=True)
class Pheromones(_Common):
    """Keep the pheromone map that a team shares."""

    file: Annotated[Path | None, tyro.conf.arg(metavar="FILE.npz")] = None
    """Keep the map in this file, too, and go on with it if it is there."""

    def run(self) -> None:
        from robosim.deploy.link.lines import Lines
        from robosim.deploy.link.session import Link
        from robosim.deploy.link.setup import setup_number
        from robosim.deploy.processes.pheromones import PheromoneService
        from robosim.deploy.processes.stopping import Ending
        from robosim.files import require_writable

        link_config, disturbance = self._link()
        _, config, arena = self._team()
        if self.file is not None:
            require_writable(self.file)
        lines = Lines("pheromones")
        with (
            Ending() as ending,
            Link(
                "pheromones",
                link_config,
                listen=link_config.map_at,
                connect=(link_config.world_at,),
                robots=config.robots,
                disturbance=disturbance,
            ) as link,
        ):
            service = PheromoneService(config, arena, setup_number(config), link, lines, self.file)
            service.run(ending)


@dataclass(frozen=True)
class Engines:
    """Play a team in both physics from the same start, and record them side by side."""

    policy: Annotated[str, tyro.conf.Positional]
    """Trained policy by name, or policy or run folder."""
    arena: str | None = None
    """Arena by name, or the path of its file; by default the policy's own."""
    robots: int | None = None
    """Team size; by default the policy's own."""
    decisions: int = 1000
    """Decisions to play."""
    seed: int = 0
    """Of where robots and pellets begin."""
    profile: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE.toml")] = None
    """What is random and wrong about robots and their tracker (docs/noise.md); by default nothing."""
    save: Annotated[Path, tyro.conf.arg(metavar="RUN.rrd")] = Path("engines.rrd")
    """The recording to write."""

    def run(self) -> None:
        from robosim.cli.engines import record_engines

        played, delivered = record_engines(self)
        said = ", ".join(f"{pellets} pellets in {engine}" for engine, pellets in delivered.items())
        print(f"{self.save}: {played} decisions, {said}\nopen it with: {hint('view', self.save)}")
        if played < self.decisions:
            raise KeyboardInterrupt


@dataclass(frozen=True)
class _OfOperator:
    team: str = "team"
    """Name of the team."""
    world_at: Annotated[str, tyro.conf.arg(metavar="HOST:PORT")] = WORLD_AT
    """Where the world listens."""
    keys: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """Folder with the operator's certificate and key; without one the link is open."""
    patience: float = 5.0
    """How long to wait for the world, and for the robots, s."""

    @contextlib.contextmanager
    def _operator(self) -> Iterator[Operator]:
        from robosim.deploy.link.access import OPERATOR, LinkConfig
        from robosim.deploy.link.lines import Lines
        from robosim.deploy.link.session import Link
        from robosim.deploy.processes.operator import Operator
        from robosim.errors import refused

        if not 0.0 < self.patience <= 1e6:
            raise refused("--patience", self.patience, "a number of seconds above 0 and of at most 1e6")
        table = {"team": self.team, "world_at": self.world_at, "keys": str(self.keys or "")}
        config = LinkConfig.from_table(table, "link")
        with Link(OPERATOR, config, connect=(config.world_at,)) as link:
            yield Operator(link, Lines(OPERATOR))


@dataclass(frozen=True)
class Stop(_OfOperator):
    """Emergency stop: hold all robots of a team until they are released, and say who could not stop."""

    reason: str = ""
    """Why, for the logs of all processes."""

    def run(self) -> None:
        with self._operator() as operator:
            robots = operator.stop(self.reason, self.patience)
        release = ["release", "--world-at", self.world_at, "--team", self.team]
        release += [] if self.keys is None else ["--keys", str(self.keys)]
        print(
            f"all {robots} robots are held, and stand; they go on after: robosim deploy {shlex.join(release)}"
        )


@dataclass(frozen=True)
class Release(_OfOperator):
    """End the emergency stop of a team: its robots go on."""

    def run(self) -> None:
        with self._operator() as operator:
            held = operator.release(self.patience)
        print("the team is released" if held else "no emergency stop holds the team")


@dataclass(frozen=True)
class Demo:
    """Start a whole team on this machine: the world, the pheromone service, and a process for each robot."""

    policy: Annotated[str, tyro.conf.Positional] = "paper-8-smadrl"
    """Trained policy by name, or policy or run folder."""
    robots: int | None = None
    """Team size; by default the policy's own."""
    speed: Annotated[str, tyro.conf.arg(metavar="NUMBER|max")] = "2"
    """Seconds of the world in a second, or `max`."""
    decisions: int = 1000
    """Decisions to play."""
    seed: int = 0
    """Of where robots and pellets begin."""
    save: Path = Path("deploy-demo.rrd")
    """The recording to write."""
    view: bool = True
    """By default the viewer opens, where there is a display, and shows what happens; with this a recording is
    all that is made."""

    def run(self) -> None:
        from robosim.control.policy import load_policy
        from robosim.deploy.controller import Controller
        from robosim.deploy.processes.launch import WORLD, TeamOfProcesses
        from robosim.playback.file import require_recording

        # All that a process would refuse, before any is started.
        _checked(self.speed, self.seed, self.decisions)
        require_recording(self.save)
        robots = Controller(load_policy(self.policy), self.robots, name=Path(self.policy).name).robots
        with tempfile.TemporaryDirectory(prefix="robosim-deploy-") as folder:
            team = TeamOfProcesses(self.policy, robots, Path(folder))
            world = ["--speed", self.speed, "--decisions", str(self.decisions), "--seed", str(self.seed)]
            world += ["--save", str(self.save.resolve()), *(["--view"] if self.view else [])]
            with team:
                team.start_all(world)
                at = team.common[team.common.index("--world-at") + 1]
                print(f"hold all robots with: robosim deploy stop --world-at {at}", flush=True)
                _follow(team.running[WORLD].poll, Path(folder))


def _follow(ended: Callable[[], int | None], folder: Path) -> None:
    """Print what all processes say, as they say it, until the world ends; IncompleteError if it fails."""
    import time

    from robosim.errors import IncompleteError

    told: dict[Path, int] = {}
    code = None
    while code is None:
        code = ended()
        for path in sorted(folder.glob("*.log")):
            text = path.read_text(encoding="utf-8", errors="replace")
            end = text.rfind("\n") + 1
            print(text[told.get(path, 0) : end], end="", flush=True)
            told[path] = end
        time.sleep(0.2)
    if code:
        raise IncompleteError("the world has not ended well; what it said is above.")


@dataclass(frozen=True)
class Deploy:
    """A team of processes: robots, the pheromone map that they share, and a world that plays reality."""

    do: Annotated[
        Annotated[World, tyro.conf.subcommand("world")]
        | Annotated[Robot, tyro.conf.subcommand("robot")]
        | Annotated[Pheromones, tyro.conf.subcommand("pheromones")]
        | Annotated[Stop, tyro.conf.subcommand("stop")]
        | Annotated[Release, tyro.conf.subcommand("release")]
        | Annotated[Engines, tyro.conf.subcommand("engines")]
        | Annotated[Demo, tyro.conf.subcommand("demo")],
        tyro.conf.arg(name=""),
    ]

    def run(self) -> None:
        self.do.run()
