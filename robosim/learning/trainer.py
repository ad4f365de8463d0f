"""A training run in its folder: begin, resume, evaluate."""

from __future__ import annotations

import contextlib
import platform
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

import robosim
from robosim.control.card import Evaluation, PolicyCard, TrainingCard, card_for
from robosim.control.evaluate import evaluate
from robosim.control.learned import LearnedController
from robosim.control.network import DRAWING, NetworkSpec, unmet_standing
from robosim.control.policy import Policy, read_policy, save_policy
from robosim.discretise.observation import find_columns
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError, shown
from robosim.files import alone_in
from robosim.learning.checkpoint import list_checkpoints, read_checkpoint, remove_checkpoints
from robosim.learning.computing import one_thread
from robosim.learning.config import EVALUATION_SEED, RunConfig, self_contained
from robosim.learning.folder import RunFolder
from robosim.learning.interrupts import hold_interrupts
from robosim.learning.metrics import Metrics, write_metrics
from robosim.learning.tensorboard import Curves
from robosim.learning.training import Training, TrainingEnv, evaluation_env

Report = Callable[[Metrics], None]
Record = Callable[[LearnedController, VectorEnv, Path], None]
"""Records an episode of a controller in an environment to a file."""
Watch = Callable[[TrainingEnv, int, Metrics | None], None]
"""Sees the environments after every decision, how many joint decisions the run has taken, and the row of the
metrics that is closed by it, if any. It must only look."""
Say = Callable[[str], None]


def ignore(_row: Metrics) -> None:
    """Show nothing of a run."""


@dataclass(frozen=True, slots=True)
class TrainResult:
    """What a finished run leaves."""

    folder: Path
    steps: int
    """Joint decisions taken."""
    wall_time: float
    """Time spent learning, all parts of an interrupted run together, s."""
    evaluation: Evaluation | None
    unlearned: tuple[str, ...] = ()
    """Stages in which nothing was learned, by name; not known of a run that was finished before."""


def train(
    config: RunConfig,
    folder: str | Path,
    report: Report = ignore,
    command: str = "",
    record: Record | None = None,
    watch: Watch | None = None,
) -> TrainResult:
    """Learn, evaluate and fill `folder`: docs/learning.md lists what is in it.

    `record` writes the playbacks that `record_every` asks for, and `watch` sees every decision. Interrupted
    (Ctrl-C, SIGTERM, or KeyboardInterrupt from `report`), the run ends its present decision, saves a
    checkpoint and the policy so far, and raises KeyboardInterrupt; `resume` goes on from there. InputError
    for a folder that is in use or cannot be written, before learning.
    """
    config, folder = self_contained(config), Path(folder)
    training, run_folder = _fitting(config), RunFolder(folder)
    run_folder.make()
    with alone_in(folder):
        return _begun(training, run_folder, report, command, record, watch)


def resume(
    folder: str | Path,
    report: Report = ignore,
    record: Record | None = None,
    warn: Say = print,
    watch: Watch | None = None,
) -> TrainResult:
    """Go on with an interrupted run from its last good checkpoint, to the same bits as if never stopped.

    `warn` hears, in a sentence, of damaged checkpoints that are passed over. InputError when `folder` holds
    no run, a finished one, one that another process is at, one whose checkpoints are all damaged, or
    something else where a run writes.
    """
    folder = Path(folder)
    run_folder = RunFolder(folder)
    run_folder.require_begun()
    with alone_in(folder):
        return _resumed(run_folder, report, record, warn, watch)


def train_or_resume(
    config: RunConfig,
    folder: str | Path,
    report: Report = ignore,
    command: str = "",
    record: Record | None = None,
    say: Say = print,
    watch: Watch | None = None,
) -> TrainResult:
    """Begin the run of `config` in `folder`, go on with it, or return what it left if it is finished.

    So that the same call, or job of a cluster, may be made again until it ends well. `say` hears, in a
    sentence each, that the run is finished already, and of damaged checkpoints that are passed over.
    InputError as of `train` and `resume`, and when the run in `folder` has another configuration.
    """
    config, folder = self_contained(config), Path(folder)
    run_folder = RunFolder(folder)
    # Before there is a folder: what does not fit together leaves none.
    training = None if run_folder.begun else _fitting(config)
    run_folder.make()
    with alone_in(folder):
        if not run_folder.begun:
            return _begun(training or _fitting(config), run_folder, report, command, record, watch)
        run_folder.require_config(config)
        result = finished_result(folder)
        if result is None:
            return _resumed(run_folder, report, record, say, watch)
        # A kill between a run's last record and this leaves them.
        remove_checkpoints(run_folder.checkpoints)
        say(f"{folder}: this run is finished; there is nothing left to do.")
        return result


def _fitting(config: RunConfig) -> Training:
    """Return a run that has not begun; InputError where its team could not act as it is to."""
    training = Training(config)
    _spec_at_work(training)
    return training


def _begun(
    training: Training,
    folder: RunFolder,
    report: Report,
    command: str,
    record: Record | None,
    watch: Watch | None,
) -> TrainResult:
    folder.begin(training.config, command, training.start)
    return _Run(training, folder, report, record, command, watch=watch).finish()


def _resumed(
    folder: RunFolder, report: Report, record: Record | None, warn: Say, watch: Watch | None
) -> TrainResult:
    config = folder.reopen()
    # As it was when the run began: what lies where it came from may be another by now.
    start = read_policy(folder.start) if config.schedule.start_from else None
    training, wall_time = _latest(config, start, folder.checkpoints, warn)
    for row in training.log.rows[-1:]:
        report(row)
    return _Run(training, folder, report, record, folder.command(), wall_time, watch).finish()


def finished_result(folder: Path) -> TrainResult | None:
    """Return what a finished run has left; None where there is no run, or one that is not finished."""
    run_folder = RunFolder(folder)
    finished = run_folder.finished()
    return (
        TrainResult(folder, finished.steps, finished.wall_time, run_folder.evaluation()) if finished else None
    )


def _latest(config: RunConfig, start: Policy | None, checkpoints: Path, warn: Say) -> tuple[Training, float]:
    """Return a run at its last good checkpoint, or at its beginning when it has none yet."""
    paths = list_checkpoints(checkpoints)
    problems: list[str] = []
    for path in paths:
        training = Training(config, start)
        try:
            checkpoint = read_checkpoint(path, training.most_bytes())
            wall_time = training.restore(checkpoint, checkpoints)
        except InputError as error:
            problems.append(str(error))
            continue
        for problem in problems:
            warn(f"{problem} Going on from the checkpoint before, at decision {checkpoint.step}.")
        return training, wall_time
    if problems:
        raise InputError("\n".join(problems))
    return Training(config, start), 0.0


class _Run:
    """A run at work in its folder."""

    def __init__(
        self,
        training: Training,
        folder: RunFolder,
        report: Report,
        record: Record | None,
        command: str,
        wall_time: float = 0.0,
        watch: Watch | None = None,
    ) -> None:
        self._training = training
        self._folder = folder
        self._report = report
        self._record = record
        self._watch = watch
        self._command = command
        self._wall_time = wall_time
        self._since = time.perf_counter()
        self._saved_at = training.step

    def finish(self) -> TrainResult:
        config, training, folder = self._training.config, self._training, self._folder
        self._learn()
        weights, card = training.actors().weights, self._card()
        evaluation = None
        if config.run.evaluation_episodes:
            controller = LearnedController(Policy(weights, card), str(folder.path))
            evaluation = evaluate_run(config, controller, training.seed(EVALUATION_SEED))
            save_policy(folder.policy, weights, card.changed(evaluation=evaluation))
            folder.write_evaluation(evaluation)
        folder.finish(training.step, self._wall_time)
        unlearned = tuple(training.unlearned)
        return TrainResult(folder.path, training.step, self._wall_time, evaluation, unlearned)

    def _learn(self) -> None:
        training, config = self._training, self._training.config
        curves = Curves(self._folder.curves, training.step)
        with hold_interrupts() as interrupted, contextlib.ExitStack() as stack:
            beside = stack.enter_context(ThreadPoolExecutor(1)) if config.run.overlap else None
            stack.enter_context(one_thread())
            stack.callback(curves.close)
            stack.callback(training.close)
            whole = True
            try:
                while not training.finished:
                    step, whole = training.step, False
                    row = training.advance(beside)
                    whole = True
                    if self._watch is not None:
                        self._watch(training.env, training.step, row)
                    if row is not None:
                        curves.add(row)
                        self._report(row)
                    # Before the checkpoint: a run that goes on from there records what comes after it.
                    if self._record is not None and _passed(config.run.record_every, step, training.step):
                        self._playback(self._record)
                    if _passed(config.run.checkpoint_every, step, training.step):
                        self._save()
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
        checkpoints = self._folder.checkpoints
        try:
            checkpoints.mkdir(exist_ok=True)
            write_metrics(self._training.log.rows, self._folder.metrics)
            self._training.save(checkpoints, self._wall_time)
        except (InputError, OSError) as error:
            left = list_checkpoints(checkpoints)
            kept = f"the checkpoint of decision {self._saved_at} is kept" if left else "there is none before"
            raise InputError(f"{str(error).rstrip('.')}; {kept}.") from error
        self._saved_at = self._training.step

    def _save_policy(self) -> None:
        save_policy(self._folder.policy, self._training.actors().weights, self._card())

    def _playback(self, record: Record) -> None:
        training, config = self._training, self._training.config
        card = self._card()
        controller = LearnedController(Policy(training.actors().weights, card), str(self._folder.path))
        # Not the stage's robots: as a stage begins, its newcomer has learned nothing and has no part yet.
        seed = training.seed(EVALUATION_SEED)
        env = evaluation_env(config, 1, seed, card.robots, config.run.record_steps)
        record(controller, env, self._folder.recording(training.step))

    def _card(self) -> PolicyCard:
        training = self._training
        stages = tuple(training.ended) if training.config.schedule.curriculum else ()
        about = TrainingCard(
            command=self._command,
            seed=training.config.run.seed,
            steps=training.step,
            wall_time=self._wall_time,
            versions=_versions(),
            stages=stages,
        )
        actors, technique = training.actors(), training.config.run.technique
        facts = {name: shown(value) for name, value in training.algorithm_config.model_dump().items()}
        return card_for(training.env, _spec_at_work(training), actors.weights, technique, about, facts)


def _spec_at_work(training: Training) -> NetworkSpec:
    """Return the networks of the team that a run leaves; InputError where they cannot act as it wants."""
    drawing = {name: getattr(training.config.run, name) for name in DRAWING}
    spec, env = training.actors().spec.changed(**drawing), training.env
    columns = find_columns(env.layout.names, env.config.actions)
    if (unmet := unmet_standing(spec, columns)) is not None:
        raise InputError(f"{unmet}.")
    return spec


def evaluate_run(config: RunConfig, controller: LearnedController, seed: int) -> Evaluation:
    """Run the whole episodes without exploration that a configuration asks for."""
    env = evaluation_env(config, config.run.evaluation_episodes, seed, steps=config.run.evaluation_steps)
    return evaluate(controller, env, config.run.evaluation_episodes, seed)


def _passed(every: int, before: int, after: int) -> bool:
    """Return whether a multiple of `every` lies beyond `before` and up to `after`; never for 0."""
    return every > 0 and after // every > before // every


def _versions() -> dict[str, str]:
    return {
        "robosim": robosim.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "torch": torch.__version__,
    }
