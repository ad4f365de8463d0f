"""What an algorithm is to the rest of learning: it acts, observes, updates, and can be saved."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from robosim.control.network import NetworkSpec
from robosim.discretise.observation import MoveGains, gain_columns
from robosim.records import Record
from robosim.robot.drivers import ActionKind

if TYPE_CHECKING:
    from torch import Tensor

Weights = Mapping[str, NDArray[np.float32]]
"""As in a policy folder: `layer0.weight` [networks, in, out], `layer0.bias` [networks, out] and so on."""


@dataclass(frozen=True, slots=True)
class Task:
    """What an algorithm has to learn in a stage."""

    robots: int
    """That learn; frozen ones are not the algorithm's affair."""
    num_envs: int
    """Environments that run side by side; where teams have several sizes, each robot counts as one."""
    names: tuple[str, ...]
    """Of the numbers in a robot's observation."""
    num_actions: int
    actions: ActionKind
    """What the actions are."""
    decisions: int
    """Joint decisions that the stage takes at most, summed over those environments."""
    explores: bool = True
    """Exploration begins anew; otherwise its share stays at the end's."""
    groups: tuple[int, ...] = ()
    """[robots] number of the group of each in a mixed team; empty in a team of equals."""

    @property
    def size(self) -> int:
        """Numbers in a robot's observation."""
        return len(self.names)

    @property
    def gains(self) -> MoveGains | None:
        """Where an observation holds the gains of moves (`gain_columns`), if it does."""
        return gain_columns(self.names, self.actions)


class Experience(NamedTuple):
    """A decision in every environment, and what came of it, for the robots that learn."""

    observation: NDArray[np.float32]
    """[envs, robots, size]."""
    action: NDArray[np.int64]
    """[envs, robots]."""
    reward: NDArray[np.float32]
    """[envs, robots]."""
    final_observation: NDArray[np.float32]
    """[envs, robots, size] what the decision led to."""
    next_observation: NDArray[np.float32]
    """[envs, robots, size] what is acted on next: of a new episode where one has ended."""
    terminated: NDArray[np.bool_]
    """[envs] the task came to its end: nothing follows."""
    truncated: NDArray[np.bool_]
    """[envs] the episode was cut off: what follows still has its value."""

    @property
    def ended(self) -> NDArray[np.bool_]:
        """[envs] the episode ended, for whichever reason."""
        return self.terminated | self.truncated


class Actors(NamedTuple):
    """The networks by which robots act once they have learned."""

    spec: NetworkSpec
    weights: Weights


class State(NamedTuple):
    """All of which an algorithm goes on to the same bits."""

    tensors: Mapping[str, Tensor]
    """Copies, on the CPU."""
    facts: Mapping[str, Any]
    """What is no tensor, as JSON."""


class Algorithm(Protocol):
    """A learner of all robots of a stage that learn; arrays are [envs, robots, ...].

    For each decision the loop calls `act`, then `update`, then `observe`. The environments may take the
    decision while `update` runs: it learns from what was observed before. (So the decision under way was
    chosen before the update; a learner that needs its own policy's decisions alone leaves that one out.)
    """

    def act(self, observation: NDArray[np.float32], progress: float) -> NDArray[np.int64]:
        """Return actions [envs, robots] to learn from, for `observation` [envs, robots, size].

        `progress` is the share of the stage that is done, 0 to 1.
        """
        ...

    def observe(self, experience: Experience) -> None:
        """Take in what came of the actions."""
        ...

    def update(self, progress: float) -> Mapping[str, float]:
        """Learn as much as is due; return figures by name for the metrics, none if there is nothing new."""
        ...

    def actors(self) -> Actors:
        """Return copies of the networks by which the robots act without exploration."""
        ...

    def state(self) -> State:
        """Return what `restore` goes on from, without what `LargeMemory` exports."""
        ...

    def restore(self, state: State) -> None:
        """Take back what `state` returned; InputError when it does not fit."""
        ...


@runtime_checkable
class LargeMemory(Protocol):
    """What an algorithm also has whose memory is too large to be written whole at every checkpoint.

    The memory is a sequence of numbered items, which grows at its end and may forget at its beginning; only
    what has been added since the checkpoint before is written.
    """

    def held(self) -> tuple[int, int]:
        """Return the number of the oldest item held, and one more than that of the latest."""
        ...

    def export(self, first: int, last: int) -> Mapping[str, Tensor]:
        """Return copies, on the CPU, of items number `first` to `last - 1`."""
        ...

    def most_bytes(self) -> int:
        """Return the most bytes that `export` may return: no part that claims more is read."""
        ...

    def recall(self, first: int, parts: Iterable[Mapping[str, Tensor]]) -> None:
        """Take back what `export` returned: items from number `first` on, in parts one after another.

        InputError when a part does not fit, or the parts hold too little.
        """
        ...


class AlgorithmConfig(Record):
    """Base of the configurations of algorithms: a frozen record with a `name`, which builds the learner."""

    short_names: ClassVar[Mapping[str, str]] = {"name": "algorithm"}

    name: str = ""
    """Of the algorithm, in the registry; each has its own as the only value."""

    @property
    def shares_parameters(self) -> bool:
        """Whether robots share networks; then none can be frozen while others learn."""
        return False

    @property
    def shares_by_group(self) -> bool:
        """Whether each group of a mixed team has a network, rather than all robots the same."""
        return False

    @property
    def needs_team(self) -> bool:
        """Whether it learns from the whole team at once, as by a mixer, joint actions or a critic of all."""
        return False

    def starting_from(self, spec: NetworkSpec) -> Self:
        """Return this configuration as networks of `spec`, from which a run is to start, need it.

        InputError, a sentence that begins with "has", when they cannot go on with this algorithm.
        """
        return self

    @abstractmethod
    def build(self, task: Task, seed: np.random.SeedSequence, start: Actors | None = None) -> Algorithm:
        """Return a learner; it draws all its numbers from `seed`.

        With `start`, its robots begin with those networks: one for each robot, or one for all where
        `shares_parameters`. InputError for what does not fit or does not exist on this machine.
        """
