"""`robosim train`: teams learn, and leave a run folder."""

from __future__ import annotations

import contextlib
import dataclasses
import shlex
import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, cast

import tyro

from robosim.cli.program import hint
from robosim.errors import InputError

if TYPE_CHECKING:
    from robosim.control.learned import LearnedController
    from robosim.envs.profile import ProfileConfig
    from robosim.envs.vector import VectorEnv
    from robosim.learning.config import RunConfig
    from robosim.learning.trainer import Report, TrainResult, Watch
    from robosim.records import Option

_GROUPS = {
    "env": "What the team learns in.",
    "variety": "Several arenas and team sizes at once, for one network that drives all.",
    "algorithm": "What learns, and how: the options of the technique's algorithm.",
    "schedule": "How much is learned, and by whom at a time.",
    "run": "How the run is carried out, and what it leaves.",
}
_NOT_GIVEN = (
    ("algorithm", "name"),
    ("run", "technique"),
    ("env", "profile", "name"),
    ("env", "profile", "description"),
)
"""Fields that are no options: they say what the others are."""


@dataclass(frozen=True)
class Train:
    """Let a team of robots learn, and keep the run in a folder: policy, metrics, config, evaluation."""

    technique: str = "ps-dqn"
    """Preset that the other options start from (docs/learning.md lists them). It also says which algorithm's
    options there are."""
    out: Path | None = None
    """New or empty folder for the run; by default runs/ARENA-ROBOTS-TECHNIQUE-SEED, runs/mixed-TECHNIQUE-SEED
    with several arenas, and either with -grid behind it in the grid world."""
    resume: Annotated[Path | None, tyro.conf.arg(metavar="RUN")] = None
    """Folder of an interrupted run to go on with, just as it was configured."""
    live: bool = False
    """Show the first environment, its clogs and the learning curve in the viewer while the team learns, and
    record them to recordings/live-*.rrd; without a display a browser shows them."""
    resume_if_present: bool = False
    """Go on with the run that is in the folder, if there is one of the same configuration; if it is finished,
    say so and end well. So a job of a cluster may be started again as it is."""
    profile: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE.toml")] = None
    """What is random and wrong about robots as they learn, by name or file (docs/noise.md); the options that
    begin with motion, sensing and pheromones change it."""

    named: ClassVar[frozenset[str]] = frozenset()
    """Options that the command line names."""

    def run(self) -> None:
        """Train with a progress display, then say what came of it."""
        if self.resume is not None:
            go_on(self.resume, live=self.live)
        else:
            from robosim.learning.config import run_config

            options = list(self._options())
            changed = [name for name, _, differs in options if differs]
            # What is named counts even where it is the default: teams with wheels, say, have other defaults.
            given = {name: value for name, value, differs in options if differs or name in self.named}
            config = run_config(self.technique, profile=self._profile(), **given)
            _refuse_options_without_effect(config, changed)
            begin(config, self.out or _run_folder(config), self.resume_if_present, live=self.live)

    def _profile(self) -> ProfileConfig | None:
        from robosim.envs.profile import load_profile

        return None if self.profile is None else load_profile(self.profile)

    def _options(self) -> Iterator[tuple[str, Any, bool]]:
        """Yield each option's name and value, and whether that differs from what the technique sets."""
        for group in _GROUPS:
            values = getattr(self, f"{group}_options", None)
            if values is not None:
                for one in dataclasses.fields(values):
                    value = getattr(values, one.name)
                    yield one.name, value, value != one.default


def train_command(arguments: Sequence[str]) -> type[Train]:
    """Return `Train` with the options that there are for the technique that the command line names.

    A group each for environment, algorithm, schedule and run, made of the fields of `RunConfig`. InputError
    for a technique that there is not, an option of another technique's algorithm, and any beside `--resume`.
    """
    from robosim.learning.config import run_config

    _refuse_options_beside_resume(arguments)
    technique = _value_of("--technique", arguments) or Train.technique
    config = run_config(technique, profile=_value_of("--profile", arguments))
    _refuse_options_of_others(config, technique, arguments)
    groups: dict[str, list[Any]] = {name: [] for name in _GROUPS}
    for name, option in config.own_options().items():
        if option.path in _NOT_GIVEN:
            continue
        value = _value_at(config, option)
        about = tyro.conf.arg(help=" ".join(option.help.split()))
        groups[option.path[0]].append((name, Annotated[option.field.annotation, about], field(default=value)))
    members: list[Any] = []
    for name, options in groups.items():
        group = dataclasses.make_dataclass(name.capitalize(), options, frozen=True)
        group.__doc__ = _GROUPS[name]
        # Not by the group's bare name, since `run` is a method.
        titled: Any = Annotated[group, tyro.conf.arg(name=name)]
        members.append((f"{name}_options", titled, field(default_factory=group)))
    named = frozenset(_name(argument) for argument in arguments if argument.startswith("--"))
    namespace = {"__doc__": Train.__doc__, "named": named}
    return dataclasses.make_dataclass("Train", members, bases=(Train,), frozen=True, namespace=namespace)


def _value_at(config: RunConfig, option: Option) -> Any:
    """Return what a configuration holds for an option; its default in a table that is not there."""
    value: Any = config
    for step in option.path:
        value = getattr(value, step)
        if value is None:
            return option.field.get_default()
    return value


def _refuse_options_beside_resume(arguments: Sequence[str]) -> None:
    """Raise InputError for them: also those that are what a technique sets, for the run may differ."""
    flags = [argument.partition("=")[0] for argument in arguments if argument.startswith("--")]
    others = [flag for flag in flags if flag not in {"--resume", "--help", "--live"}]
    if "--resume" in flags and others:
        raise InputError(
            f"--resume goes on with a run as it was configured: {others[0]} cannot be given with it."
        )


def _refuse_options_of_others(config: RunConfig, technique: str, arguments: Sequence[str]) -> None:
    """Raise InputError for an option that only other algorithms have."""
    from robosim.learning.algorithms.registry import algorithm_names, find_algorithm

    own = {*config.own_options(), *(one.name for one in dataclasses.fields(Train)), "help", "debug"}
    strange = {_name(argument) for argument in arguments if argument.startswith("--")} - own
    for other in algorithm_names() if strange else ():
        found = sorted(strange & find_algorithm(other).model_fields.keys() - {"name"})
        if found:
            raise InputError(
                f"{_flag(found[0])} is an option of the algorithm {other}: technique {technique} learns by "
                f"{config.algorithm.name}."
            )


def _refuse_options_without_effect(config: RunConfig, given: Collection[str]) -> None:
    """Raise InputError for an option that only matters together with another one, which is not there."""
    from robosim.learning.idle import idle_options

    for idle in idle_options(config, given):
        if idle.needs:
            raise InputError(
                f"{_flag(idle.name)} changes nothing without {_flag(idle.needs)}: leave it out, or give both."
            )
        why = idle.why.replace("start_from", _flag("start_from"))
        raise InputError(f"{_flag(idle.name)} changes nothing here: {why}. Leave it out.")


def begin(config: RunConfig, folder: Path, resume_if_present: bool = False, *, live: bool = False) -> None:
    """Train, with a progress display, and fill the run folder, or go on with the run that is in it.

    `live` shows it in the viewer, too.
    """
    from robosim.learning.trainer import train, train_or_resume

    command = shlex.join(["robosim", *sys.argv[1:]])[:2000]
    with _watching(config, folder, live) as watch:

        def work(report: Report) -> TrainResult:
            if resume_if_present:
                return train_or_resume(config, folder, report, command, _record, _warn, watch)
            return train(config, folder, report, command, _record, watch)

        _shown(config, folder, work)


def go_on(folder: Path, live: bool = False) -> None:
    """Go on with an interrupted run, with a progress display; `live` shows it in the viewer, too."""
    from robosim.learning.config import RunConfig, read_config
    from robosim.learning.folder import CONFIG_FILE
    from robosim.learning.trainer import resume

    config = read_config(folder / CONFIG_FILE) if (folder / CONFIG_FILE).is_file() else RunConfig()
    with _watching(config, folder, live) as watch:
        _shown(config, folder, lambda report: resume(folder, report, _record, _warn, watch))


@contextlib.contextmanager
def _watching(config: RunConfig, folder: Path, live: bool) -> Iterator[Watch | None]:
    """Give what shows a training in the viewer, if it is to be shown."""
    if not live:
        yield None
        return
    if config.variety is not None:
        raise InputError("--live shows one team in one arena: not where arenas and team sizes vary.")
    from robosim.cli.view import say
    from robosim.learning.folder import RECORDINGS
    from robosim.playback.training import LiveTraining
    from robosim.playback.viewer import live_viewer

    about = {"technique": config.run.technique, "seed": str(config.run.seed), "run": folder.name}
    viewer = live_viewer(say, lingers=False)
    watch = LiveTraining(folder / RECORDINGS, about, viewer, lambda words: say(f"live: {words}"))
    # Every environment but those of a variety can be looked at.
    with contextlib.closing(watch):
        yield cast("Watch", watch)


def _shown(config: RunConfig, folder: Path, work: Callable[[Report], TrainResult]) -> None:
    from robosim.learning.folder import CONFIG_FILE
    from robosim.learning.progress import show_progress

    steps = config.schedule.steps
    try:
        with show_progress(steps) as report:
            result = work(report)
    except KeyboardInterrupt:
        if (folder / CONFIG_FILE).exists():
            print(f"Stopped; go on with: {hint('train', '--resume', folder)}")
        raise
    print(f"{result.steps} joint decisions in {result.wall_time:.0f} s; run folder {folder}")
    if result.unlearned:
        _warn(_nothing_learned(config, result.unlearned))
    if result.evaluation is not None:
        from robosim.cli.evaluate import summary

        print(summary(result.evaluation))


def _nothing_learned(config: RunConfig, stages: Sequence[str]) -> str:
    """Return the sentence that says in which stages nothing was learned, and what may have kept it."""
    where = f" in the stages {', '.join(stages)}" if config.schedule.curriculum else ""
    warmup = getattr(config.algorithm, "warmup", None)
    first = f": the first update comes after {warmup} decisions of a stage (warmup)" if warmup else ""
    return f"Nothing was learned{where}{first}; more --steps are needed, or updates that come earlier."


def _run_folder(config: RunConfig) -> Path:
    team = f"{Path(config.env.arena).stem}-{config.env.robots}" if config.variety is None else "mixed"
    world = "" if config.env.world == "physics" else f"-{config.env.world}"
    return Path("runs") / f"{team}-{config.run.technique}-{config.run.seed}{world}"


def _value_of(flag: str, arguments: Sequence[str]) -> str | None:
    """Return what a command line gives an option, if it does; the last one counts."""
    value = None
    for place, argument in enumerate(arguments):
        if argument == flag and place + 1 < len(arguments):
            value = arguments[place + 1]
        elif argument.startswith(f"{flag}="):
            value = argument.partition("=")[2]
    return value


def _name(argument: str) -> str:
    """Return the field that an option names: `--no-mask` and `--mask=...` name mask."""
    return argument.partition("=")[0].removeprefix("--").removeprefix("no-").replace("-", "_")


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _record(controller: LearnedController, env: VectorEnv, path: Path) -> None:
    from robosim.playback.episode import record_episode

    env.autoreset = False
    record_episode(controller, env, path, about={"policy": controller.name})


def _warn(sentence: str) -> None:
    print(sentence, file=sys.stderr, flush=True)
