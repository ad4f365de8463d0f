"""A training run from its first decision to its last: stages, and the moments that it can be resumed from."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import Field, TypeAdapter

from robosim.control.card import MOST, StageCard
from robosim.control.learned import check_start
from robosim.control.network import DRAWING, NetworkSpec
from robosim.control.policy import Policy, load_policy
from robosim.envs.mixed import MixedVectorEnv
from robosim.envs.vector import MAX_SEED, Snapshot, VectorEnv
from robosim.envs.workers import WorkerVectorEnv, vector_env
from robosim.errors import InputError, printable, shown, whole_number
from robosim.learning.actors import FrozenTeam, expanded, joined, robots_of
from robosim.learning.algorithms.protocol import Actors, AlgorithmConfig, LargeMemory, Task
from robosim.learning.checkpoint import Checkpoint, part_name, read_part, write_checkpoint, write_part
from robosim.learning.config import RunConfig, child_seed
from robosim.learning.curriculum import Ending, Stage, is_steady, plan_stages, stage_budget
from robosim.learning.loop import StageLoop
from robosim.learning.metrics import Metrics, MetricsLog, Sums

_LONGEST_ROLLOUT = 10_000
"""Decisions that an algorithm keeps from one update to the next, at most."""
_MOST_FACTS = 2**26
"""Bytes of a checkpoint that are no tensor."""
_WALL_TIME = TypeAdapter(Annotated[float, Field(ge=0, le=MOST)])
_ROWS = TypeAdapter(list[Metrics])
_SUMS = TypeAdapter(Sums)

TrainingEnv = VectorEnv | WorkerVectorEnv | MixedVectorEnv


class Training:
    """Everything that changes while a team learns."""

    def __init__(self, config: RunConfig, start: Policy | None = None) -> None:
        """Read the arena and the policy to start from, if any; InputError when something does not fit.

        `start` is that policy where it has been read, as it was when the run began.
        """
        self.config = config
        self.start = start
        """The policy that the run starts from, if any."""
        self.log = MetricsLog()
        self.step = 0
        """Joint decisions of the run so far."""
        self.ended: list[StageCard] = []
        """The stages that are over."""
        self.unlearned: list[str] = []
        """Those of them that left the networks as they were at their beginning, by name."""
        self.algorithm_config: AlgorithmConfig = config.algorithm
        """Of what learns; as the policy that the run starts from needs it."""
        self._team: Actors | None = None
        """Networks of the robots that have learned in earlier stages."""
        if config.schedule.start_from:
            self.start = start or load_policy(config.schedule.start_from)
            self.algorithm_config, self._team = starting_team(config, self.start)
        self.stages = plan_stages(config, 0 if self._team is None else self._team.spec.robots)
        self._saved: list[tuple[int, int, str]] = []
        """Parts of the present stage's memory that are on disk: first item, last + 1, file."""
        self._begin(0)

    @property
    def finished(self) -> bool:
        """Whether all stages are over."""
        return len(self.ended) == len(self.stages)

    @property
    def stage(self) -> Stage:
        """The present stage, or the last when all are over."""
        return self.stages[min(len(self.ended), len(self.stages) - 1)]

    def advance(self, beside: Executor | None = None) -> Metrics | None:
        """Take one decision in every environment; returns the row of the metrics that it closes, if any.

        `beside` is explained in `StageLoop.advance`.
        """
        loop = self.loop
        row = loop.advance(beside)
        self.step += self.env.joint_decisions
        if row is None:
            return None
        rows = [one for one in self.log.rows if one.stage == self.stage.name]
        if loop.finished:
            self._end("budget")
        elif self.config.schedule.curriculum and is_steady(
            rows, loop.budget, self.config.schedule.steady_gain
        ):
            self._end("steady")
        return row

    def actors(self) -> Actors:
        """Return the networks of all robots so far, those that learn at present last."""
        if self._team is not None and (self.finished or not self.loop.step):
            return self._team
        actors = self.algorithm.actors()
        if self.config.variety is not None:
            # One network, as if of one robot: it drives as many as the card's environment has.
            of_robot = (0,) * self.config.env.robots
            actors = Actors(actors.spec.changed(of_robot=of_robot), actors.weights)
        return joined(self._team if self.stage.frozen else None, actors)

    def close(self) -> None:
        """End what the environments run in."""
        if isinstance(self.env, WorkerVectorEnv):
            self.env.close()

    def _end(self, ending: Ending) -> None:
        stage = self.stage
        if _digest(self.algorithm.actors()) == self._fresh:
            self.unlearned.append(stage.name)
        self._team = self.actors()
        self.ended.append(
            StageCard(
                name=stage.name,
                robots=stage.robots,
                learning=stage.learning,
                steps=self.loop.step,
                ended=ending,
            )
        )
        if not self.finished:
            self._begin(len(self.ended))

    def _begin(self, number: int) -> None:
        stage, config = self.stages[number], self.config
        learner_seed, env_seed = 2 * number + (number > 0), 2 * number + 1 + (number > 0)
        budget = stage_budget(self.stages, number, max(1, config.schedule.steps - self.step))
        if number or self.step:
            self.close()
        self.env = training_env(config, self.seed(env_seed), stage.robots)
        task = task_of(self.env, stage, budget)
        frozen, start, team = None, None, self._team
        if stage.frozen and team is not None:
            frozen = FrozenTeam(team, task.gains)
            if not stage.explores:
                # A newcomer that copies takes after the robot before it.
                start = robots_of(team, stage.frozen - 1, stage.frozen)
        elif team is not None:
            start = team if self.algorithm_config.shares_parameters else expanded(team)
        seed = np.random.SeedSequence(config.run.seed, spawn_key=(learner_seed,))
        self.algorithm = self.algorithm_config.build(task, seed, start)
        self._fresh = _digest(self.algorithm.actors())
        """Of the networks as the stage begins."""
        self._saved = []
        self.log.begin_stage()
        self.loop = StageLoop(stage, budget, self.env, self.algorithm, frozen, self.log)

    def seed(self, child: int) -> int:
        """Return a number drawn from a child of the run's root seed."""
        return child_seed(self.config.run.seed, child)

    def save(self, folder: Path, wall_time: float) -> None:
        """Write a checkpoint, `wall_time` (s) into the run.

        InputError, and the one before untouched, when it cannot be written.
        """
        tensors: dict[str, torch.Tensor] = {}
        facts: dict[str, Any] = {
            "config": self.config.fingerprint,
            "ended": [stage.model_dump() for stage in self.ended],
            "unlearned": self.unlearned,
            "sums": asdict(self.log.sums),
            "rows": [asdict(row) for row in self.log.rows],
            "wall_time": wall_time,
        }
        if self._team is not None:
            facts["team"] = self._team.spec.model_dump()
            tensors |= {f"team.{name}": torch.from_numpy(a) for name, a in self._team.weights.items()}
        if not self.finished:
            snapshot = self.env.snapshot()
            self._save_memory(folder)
            own, loop = self.loop.state()
            tensors |= own
            tensors["actions"] = torch.from_numpy(snapshot.actions)
            facts |= {
                "loop": loop,
                "seeds": snapshot.seeds,
                "episode": snapshot.episode,
                "memory": self._saved,
            }
        write_checkpoint(folder, Checkpoint(self.step, tensors, facts, tuple(n for _, _, n in self._saved)))

    def _save_memory(self, folder: Path) -> None:
        """Write what has been added since the checkpoint before, and forget what the memory has dropped."""
        if not isinstance(self.algorithm, LargeMemory):
            return
        (oldest, end), number = self.algorithm.held(), len(self.ended)
        saved = [part for part in self._saved if part[1] > oldest]
        first = max(saved[-1][1] if saved else 0, oldest)
        if first < end:
            name = part_name(number, first, end)
            write_part(folder, name, self.algorithm.export(first, end))
            saved.append((first, end, name))
        self._saved = saved

    def most_bytes(self) -> int:
        """Return what a checkpoint of this run may take at most, with room to spare."""
        env = self.env
        robots = env.num_envs * env.robots
        own = sum(tensor.nbytes for tensor in self.loop.state().tensors.values())
        rollout = _LONGEST_ROLLOUT * robots * (12 * env.layout.size + 64)
        # Later stages may have as many networks as robots.
        return _MOST_FACTS + rollout + env.episode_steps * robots + 8 * own * self.config.env.robots

    def restore(self, checkpoint: Checkpoint, folder: Path) -> float:
        """Go back to a checkpoint that a run of the same configuration wrote; returns its wall time, s.

        InputError when it, or a part of its experience in `folder`, is damaged or of another run.
        """
        try:
            wall_time = _WALL_TIME.validate_python(checkpoint.facts.get("wall_time", 0.0), strict=True)
            self._restore(checkpoint.tensors, checkpoint.facts, folder)
            if not self.finished and self.step + self.loop.step != checkpoint.step:
                raise ValueError(f"step is {shown(checkpoint.step)}, and not what its stages add up to")
        except InputError:
            raise
        except (LookupError, TypeError, ValueError, ArithmeticError, AttributeError, RuntimeError) as error:
            reason = printable(f"{type(error).__name__}: {error}", 200)
            raise InputError(f"the checkpoint is not one of this run ({reason}).") from error
        self.step = checkpoint.step
        return wall_time

    def _restore(self, tensors: Mapping[str, torch.Tensor], facts: Mapping[str, Any], folder: Path) -> None:
        if facts["config"] != self.config.fingerprint:
            raise InputError("the checkpoint is of a run with another configuration.")
        self.ended = [StageCard.model_validate(stage) for stage in facts["ended"]]
        if [stage.name for stage in self.ended] != [stage.name for stage in self.stages[: len(self.ended)]]:
            raise ValueError("its stages are not those of the run")
        self.unlearned = [stage.name for stage in self.ended if stage.name in facts["unlearned"]]
        if "team" in facts:
            prefix = "team."
            team = {n.removeprefix(prefix): t.numpy() for n, t in tensors.items() if n.startswith(prefix)}
            self._team = Actors(NetworkSpec.model_validate(facts["team"]), team)
        self.log.rows[:] = _ROWS.validate_python(facts["rows"])
        sums = _SUMS.validate_python(facts["sums"])
        for counted in (asdict(sums), *map(asdict, self.log.rows)):
            numbers = [number for number in counted.values() if isinstance(number, int)]
            if not all(0 <= number <= MOST for number in numbers):
                raise ValueError("its figures are not those of a run")
        if not self.finished:
            # The stage began when the run had taken this many decisions; its budget depends on that.
            self.step = sum(stage.steps for stage in self.ended)
            self._begin(len(self.ended))
            seeds = tuple(whole_number("seeds", seed, 0, MAX_SEED) for seed in facts["seeds"])
            episode = whole_number("episode", facts["episode"], 0, MOST)
            actions, step = tensors["actions"].numpy(), facts["loop"]["step"]
            # Before the episode is run again, which takes as long as it lasts.
            if not len(actions) * self.env.joint_decisions <= whole_number("step", step, 0, self.loop.budget):
                raise ValueError("it holds more actions than decisions")
            snapshot = Snapshot(seeds, episode, actions)
            self.loop.restore(tensors, facts["loop"], self.env.restore(snapshot))
            self._saved = self._parts(facts["memory"])
            if self._saved and isinstance(self.algorithm, LargeMemory):
                most = self.algorithm.most_bytes()
                parts = (read_part(folder, name, most) for _, _, name in self._saved)
                self.algorithm.recall(self._saved[0][0], parts)
        self.log.sums = sums

    def _parts(self, listed: Sequence[Sequence[Any]]) -> list[tuple[int, int, str]]:
        """Return the parts of the memory that a checkpoint lists; ValueError where one does not follow."""
        parts: list[tuple[int, int, str]] = []
        for first, last, name in listed:
            after = parts[-1][1] if parts else first
            if not 0 <= after == first < last or name != part_name(len(self.ended), first, last):
                raise ValueError(f"{shown(name)} is not the next part of its experience")
            parts.append((first, last, name))
        return parts


def _digest(actors: Actors) -> str:
    """Return what tells networks apart from any others."""
    digest = hashlib.sha256()
    for array in actors.weights.values():
        digest.update(array.tobytes())
    return digest.hexdigest()


def starting_team(config: RunConfig, policy: Policy) -> tuple[AlgorithmConfig, Actors]:
    """Return how a run learns that starts from a policy, and its networks; InputError if they do not fit."""
    card, start = policy.card, config.schedule.start_from
    spec, robots = card.network, config.env.robots
    try:
        algorithm = config.algorithm.starting_from(spec)
    except InputError as error:
        raise InputError(f"start_from {shown(start)} {error}") from None
    if card.robots <= robots or spec.shared:
        check_start(card, evaluation_env(config, 1, 0, min(card.robots, robots)), start)
    # How a team draws its actions is said by the run that leaves it, not by the one that begins with it.
    actors = Actors(spec.changed(precision="float32", **dict.fromkeys(DRAWING)), policy.weights())
    if algorithm.shares_parameters and spec.shared:
        # One network drives a team of any size.
        actors = Actors(actors.spec.changed(of_robot=(0,) * robots), actors.weights)
    return algorithm, actors


def task_of(env: TrainingEnv, stage: Stage, budget: int) -> Task:
    """Return what there is to learn in a stage of at most `budget` joint decisions.

    Where teams have several sizes, each robot is an environment of its own to the algorithm.
    """
    layout, groups = env.layout, ()
    if layout.kinds and not isinstance(env, MixedVectorEnv):
        groups = tuple(env.arena.team(env.robots).group.tolist())[stage.frozen :]
    return Task(
        robots=env.robots - stage.frozen,
        num_envs=env.num_envs,
        names=tuple(layout.names),
        num_actions=env.num_actions,
        actions=layout.actions,
        decisions=budget * env.num_envs // env.joint_decisions,
        groups=groups,
        explores=stage.explores,
    )


def training_env(config: RunConfig, seed: int, robots: int) -> TrainingEnv:
    """Return the environments in which `robots` robots learn, or as many as `config.variety` says."""
    workers, num_envs = config.run.workers, config.schedule.num_envs
    if config.variety is not None:
        return MixedVectorEnv(config.env, config.variety, num_envs=num_envs, seed=seed)
    return vector_env(config.env, num_envs=num_envs, seed=seed, workers=workers, robots=robots)


def evaluation_env(
    config: RunConfig, num_envs: int, seed: int, robots: int | None = None, steps: int = 0
) -> VectorEnv:
    """Return environments to see what a team has learned in: pellets lie evenly as an episode begins.

    `steps` is the length of an episode, 0 for the arena's own. The profile is that of evaluation, not that
    under which the team learns.
    """
    robots = config.env.robots if robots is None else robots
    return VectorEnv(
        config.env.changed(profile=None),
        num_envs=num_envs,
        seed=seed,
        robots=robots,
        pellet_gradient=0.0,
        episode_steps=steps,
        profile=config.run.evaluation_profile,
    )
