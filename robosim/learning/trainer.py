"""A training run and the folder that it fills: begin, resume, evaluate."""

from __future__ import annotations

import contextlib
import platform
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import numpy as np
import torch

import robosim
from robosim.control.card import (
    Evaluation,
    PolicyCard,
    TrainingCard,
    card_for,
)
from robosim.control.evaluate import evaluate
from robosim.control.learned import LearnedController
from robosim.control.network import NetworkSpec, Weights
from robosim.control.policy import RUN_POLICY, Policy, save_policy
from robosim.discretise.observation import gain_columns
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError
from robosim.files import write_whole
from robosim.learning.checkpoint import list_checkpoints, read_checkpoint
from robosim.learning.config import TrainConfig, read_config, write_config
from robosim.learning.metrics import Metrics, write_metrics
from robosim.learning.tensorboard import Curves
from robosim.learning.training import EVALUATION_SEED, Training, count_robots, make_env

CONFIG_FILE = "config.toml"
METRICS_FILE = "metrics.parquet"
EVALUATION_FILE = "evaluation.json"
COMMAND_FILE = "command.txt"
CHECKPOINTS = "checkpoints"
RECORDINGS = "recordings"
CURVES = "tensorboard"
FACTS = {"algorithm": "double DQN"}
"""What cards say of how the weights were learned, beside the command."""

Report = Callable[[Metrics], None]
Record = Callable[[LearnedController, VectorEnv, Path], None]
"""Records an episode of a controller in an environment to a file."""
Warn = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class TrainResult:
    """What a finished run leaves."""

    folder: Path
    wall_time: float
    """Time spent learning, all parts of an interrupted run together, s."""
    evaluation: Evaluation | None


def train(
    config: TrainConfig, folder: Path, report: Report, command: str = "", record: Record | None = None
) -> TrainResult:
    """Learn, evaluate and fill `folder`: docs/learning.md lists what is in it.

    `record` writes the playbacks that `record_every` asks for. Interrupted (Ctrl-C, SIGTERM, or
    KeyboardInterrupt from `report`), the run ends its present decision, saves a checkpoint and the policy so
    far, and raises KeyboardInterrupt; `resume` goes on from there. InputError for a folder that is in use or
    cannot be written, before learning.
    """
    training = Training(config)
    prepare_folder(folder)
    write_config(config, folder / CONFIG_FILE)
    write_whole(folder / COMMAND_FILE, command + "\n")
    return _Run(training, folder, report, record, command).finish()


def resume(folder: Path, report: Report, record: Record | None = None, warn: Warn = print) -> TrainResult:
    """Go on with an interrupted run from its last good checkpoint, to the same bits as if never stopped.

    `warn` hears, in a sentence, of damaged checkpoints that are passed over. InputError when `folder` holds
    no run, a finished one, or one whose checkpoints are all damaged.
    """
    if not (folder / CONFIG_FILE).is_file():
        raise InputError(f"{folder}: no run to resume: there is no {CONFIG_FILE} in it.")
    config = read_config(folder / CONFIG_FILE)
    if is_finished(config, folder):
        raise InputError(f"{folder}: this run is finished; there is nothing to resume.")
    try:
        command = (folder / COMMAND_FILE).read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError):
        command = ""
    training, wall_time = _latest(config, folder / CHECKPOINTS, warn)
    for row in training.log.rows[-1:]:
        report(row)
    return _Run(training, folder, report, record, command, wall_time).finish()


def is_finished(config: TrainConfig, folder: Path) -> bool:
    """Return whether a run has come to its end."""
    last = EVALUATION_FILE if config.evaluation_episodes else METRICS_FILE
    return (folder / last).is_file() and not list_checkpoints(folder / CHECKPOINTS)


def _latest(config: TrainConfig, checkpoints: Path, warn: Warn) -> tuple[Training, float]:
    """Return a run at its last good checkpoint, or at its beginning when it has none yet."""
    paths = list_checkpoints(checkpoints)
    problems: list[str] = []
    for path in paths:
        training = Training(config)
        try:
            checkpoint = read_checkpoint(path)
            training.restore(checkpoint, checkpoints)
        except InputError as error:
            problems.append(str(error))
            continue
        for problem in problems:
            warn(f"{problem} Going on from the checkpoint before, at decision {checkpoint.step}.")
        return training, float(checkpoint.facts.get("wall_time", 0.0))
    if problems:
        raise InputError("\n".join(problems))
    return Training(config), 0.0


class _Run:
    """A run at work in its folder."""

    def __init__(
        self,
        training: Training,
        folder: Path,
        report: Report,
        record: Record | None,
        command: str,
        wall_time: float = 0.0,
    ) -> None:
        self._training = training
        self._folder = folder
        self._report = report
        self._record = record
        self._command = command
        self._wall_time = wall_time
        self._since = time.perf_counter()
        self._saved_at = training.step

    def finish(self) -> TrainResult:
        config, training, folder = self._training.config, self._training, self._folder
        self._learn()
        weights, card = training.weights(), self._card()
        evaluation = None
        if config.evaluation_episodes:
            controller = LearnedController(Policy(weights, card), str(folder))
            evaluation = evaluate_run(config, controller, training.seed(EVALUATION_SEED))
            save_policy(folder / RUN_POLICY, weights, card.changed(evaluation=evaluation))
            write_whole(folder / EVALUATION_FILE, evaluation.model_dump_json(indent=2) + "\n")
        # Not before: until here a kill must find something to go on from.
        for path in (folder / CHECKPOINTS).glob("*"):
            path.unlink()
        with contextlib.suppress(OSError):
            (folder / CHECKPOINTS).rmdir()
        return TrainResult(folder, self._wall_time, evaluation)

    def _learn(self) -> None:
        training, config = self._training, self._training.config
        curves = Curves(self._folder / CURVES, training.step)
        with _interrupts() as interrupted, contextlib.ExitStack() as stack:
            beside = stack.enter_context(ThreadPoolExecutor(1)) if config.overlap else None
            stack.callback(curves.close)
            whole = True
            try:
                while not training.finished:
                    step, whole = training.step, False
                    row = training.advance(beside)
                    whole = True
                    if row is not None:
                        curves.add(row)
                        self._report(row)
                    if _passed(config.checkpoint_every, step, training.step):
                        self._save()
                    if self._record is not None and _passed(config.record_every, step, training.step):
                        self._playback(self._record)
                    if interrupted():
                        raise KeyboardInterrupt
            except KeyboardInterrupt:
                # In the midst of a decision nothing fits together; the checkpoint before still does.
                if whole:
                    self._save()
                    self._save_policy()
                raise
            self._save()
            self._save_policy()

    def _save(self) -> None:
        now = time.perf_counter()
        self._wall_time, self._since = self._wall_time + now - self._since, now
        try:
            (self._folder / CHECKPOINTS).mkdir(exist_ok=True)
            write_metrics(self._training.log.rows, self._folder / METRICS_FILE)
            self._training.save(self._folder / CHECKPOINTS, self._wall_time)
        except (InputError, OSError) as error:
            left = list_checkpoints(self._folder / CHECKPOINTS)
            kept = f"the checkpoint of decision {self._saved_at} is kept" if left else "there is none before"
            raise InputError(f"{str(error).rstrip('.')}; {kept}.") from error
        self._saved_at = self._training.step

    def _save_policy(self) -> None:
        save_policy(self._folder / RUN_POLICY, self._training.weights(), self._card())

    def _playback(self, record: Record) -> None:
        training, config = self._training, self._training.config
        card = self._card()
        controller = LearnedController(Policy(training.weights(), card), str(self._folder))
        # Not the stage's robots: as a stage begins, its newcomer has learned nothing and has no part yet.
        env = make_env(config, 1, training.seed(EVALUATION_SEED), card.robots, config.record_steps)
        (self._folder / RECORDINGS).mkdir(exist_ok=True)
        record(controller, env, self._folder / RECORDINGS / f"{training.step:012d}.rrd")

    def _card(self) -> PolicyCard:
        training = self._training
        stages = tuple(training.ended) if training.technique.curriculum else ()
        about = TrainingCard(
            command=self._command,
            seed=training.config.seed,
            steps=training.step,
            wall_time=self._wall_time,
            versions=_versions(),
            stages=stages,
        )
        weights = training.weights()
        return card_for(training.env, self._spec(weights), weights, training.technique.name, about, FACTS)

    def _spec(self, weights: Weights) -> NetworkSpec:
        training, env, technique = self._training, self._training.env, self._training.technique
        gains = gain_columns(env.layout.names, env.layout.actions)
        shared, networks = technique.parameter_sharing, range(count_robots(weights))
        return NetworkSpec(
            inputs=env.layout.size,
            hidden=training.config.hidden,
            normalisation="rms" if technique.normalised else "none",
            mask=technique.action_mask and gains is not None,
            actions=env.num_actions,
            of_robot=(0,) * env.robots if shared else tuple(networks),
        )


def evaluate_run(config: TrainConfig, controller: LearnedController, seed: int) -> Evaluation:
    """Run the whole episodes without exploration that a configuration asks for."""
    env = make_env(config, config.evaluation_episodes, seed, steps=config.evaluation_steps)
    return evaluate(controller, env, config.evaluation_episodes, seed)


def prepare_folder(folder: Path) -> None:
    """Make the run folder; InputError if there is something in it, or it cannot be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            held = (
                "holds a run; `--resume` goes on with it"
                if (folder / CONFIG_FILE).exists()
                else "is not empty"
            )
            raise InputError(f"{folder}: this folder {held}; a new run needs a new one.")
        probe = folder / CONFIG_FILE
        probe.touch()
    except FileExistsError:
        raise InputError(f"{folder}: this is a file; a run needs a folder.") from None
    except OSError as error:
        raise InputError(f"{folder}: the run folder cannot be written: {error.strerror or error}.") from None


def _passed(every: int, before: int, after: int) -> bool:
    """Return whether a multiple of `every` lies beyond `before` and up to `after`; never for 0."""
    return every > 0 and after // every > before // every


@contextlib.contextmanager
def _interrupts() -> Iterator[Callable[[], bool]]:
    """Hold Ctrl-C and SIGTERM back, and yield what tells whether one came; a second one interrupts at once.

    Signals only reach the main thread; in another one this holds nothing back.
    """
    came: list[int] = []

    def take(number: int, _frame: FrameType | None) -> None:
        if came:
            raise KeyboardInterrupt
        came.append(number)

    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    before = {number: signal.signal(number, take) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(came)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _versions() -> dict[str, str]:
    return {
        "robosim": robosim.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "torch": torch.__version__,
    }
