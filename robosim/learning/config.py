"""The configuration of a training run, and the TOML file that keeps it."""

from __future__ import annotations

import math
import tomllib
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from robosim.errors import InputError, nearest_names
from robosim.learning.technique import find_technique

if TYPE_CHECKING:
    from robosim.discretise.pheromone import PheromoneConfig


@dataclass(frozen=True, slots=True)
class TrainConfig:
    """Everything that a run depends on."""

    arena: str = "paper"
    """Arena by name, or the path of its file."""
    robots: int = 2
    """Size of the team."""
    technique: str = "ps-dqn"
    """iql, iql+g, iql+gs and smadrl as in the paper; iql+s, iql+sc and ps-dqn are ours."""
    steps: int = 30_000
    """Joint decisions in total, summed over environments and over the stages of a curriculum."""
    seed: int = 0
    """Root of all randomness of the run."""
    num_envs: int = 8
    """Environments that run side by side."""
    actions: Literal["cardinal", "wheels"] = "cardinal"
    """What the five actions are."""
    encoding: Literal["paper", "expanded"] = "expanded"
    """How observations are written."""
    sharing: Literal["copied", "split"] = "copied"
    """Whether a global reward is paid to every robot in full, or in equal parts."""
    pheromone_decay: float = 0.1
    """alpha: the share of the pheromone that is lost in a decision."""
    pheromone_reinforcement: float = 0.1
    """beta: what a visit adds in a decision."""
    pheromone_diffusion: float = 0.02
    """The share of the difference that flows between neighbouring cells in a decision."""
    pheromone_radius: int = 2
    """Field of view: robots read the pheromones up to so many rows and columns away."""
    pellet_gradient: float = 8.0
    """How unevenly pellets lie as training episodes begin, as they do after long digging; 0 for evenly."""
    episode_steps: int = 1250
    """Decisions in a training episode; 0 for as many as the arena says."""
    learning_rate: float = 1e-3
    """Step size of Adam at the start."""
    learning_rate_end: float = 0.02
    """Share of the step size that is left at the end; it falls linearly. 1 keeps it."""
    discount: float = 0.95
    """Gamma: what a reward one decision later is worth."""
    return_steps: int = 3
    """Decisions whose rewards are summed before the estimate of what follows takes over."""
    batch_size: int = 64
    """Transitions of each robot in an update."""
    epsilon_start: float = 1.0
    """Share of random actions at the start."""
    epsilon_end: float = 0.02
    """Share of random actions once exploration has run down."""
    epsilon_spread: float = 7.0
    """How much less further environments explore: the i-th of n by epsilon ** (1 + spread * i / (n - 1))."""
    exploration: float = 0.1
    """Share of the run over which the share of random actions falls."""
    hidden: tuple[int, ...] = (128, 128, 128)
    """Width of each hidden layer."""
    replay_capacity: int = 100_000
    """Transitions kept of each robot; the oldest go first."""
    warmup: int = 1000
    """Joint decisions before the first update."""
    updates_per_step: float = 0.5
    """Updates per joint decision."""
    target_interval: int = 100
    """Updates between two copies of the network into its target network."""
    reward_scale: float = 0.1
    """Factor on rewards before learning."""
    first_team: int = 2
    """Curriculum: robots that learn together first."""
    newcomer: Literal["scratch", "copy"] = "scratch"
    """Curriculum: a newcomer starts from random weights, or from a copy of the robot before it."""
    fine_tune: float = 0.0
    """Curriculum: share of the decisions, at the end, in which the whole team learns."""
    steady_gain: float = 0.0
    """Curriculum: a stage ends early once a fifth of it gains less return than this share; 0 for never."""
    start_from: str = ""
    """Policy by name or folder whose robots the run starts with; empty for none."""
    checkpoint_every: int = 10_000
    """Joint decisions between two checkpoints, to be resumed from; 0 for none but at an interrupt."""
    record_every: int = 0
    """Joint decisions between two playbacks of the team so far; 0 for none."""
    record_steps: int = 500
    """Decisions in each of them."""
    overlap: bool = False
    """Act and learn at the same time, on two cores; the result is the same."""
    device: str = "cpu"
    """Where the networks learn: cpu, or cuda for a GPU. The environments always run on the processor."""
    precision: Literal["float32", "bfloat16"] = "float32"
    """What the matrix products of an update round to; bfloat16 needs a processor that has units for it."""
    evaluation_episodes: int = 5
    """Episodes without exploration after training; 0 for none."""
    evaluation_steps: int = 0
    """Decisions in each of them; 0 for as many as the arena says."""

    def __post_init__(self) -> None:
        """Check every field; InputError names the first that is wrong."""
        find_technique(self.technique)
        self.pheromone()
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and low <= value <= high):
                raise InputError(f"{name} is {value}: it must be a number from {low:g} to {high:g}.")
        for name, allowed in _CHOICES.items():
            if getattr(self, name) not in allowed:
                raise InputError(f"{name} is {getattr(self, name)!r}: it must be {' or '.join(allowed)}.")
        if not 1 <= len(self.hidden) <= 8 or not all(1 <= width <= 4096 for width in self.hidden):
            raise InputError(f"hidden is {self.hidden}: it must be 1 to 8 widths from 1 to 4096.")
        if self.epsilon_end > self.epsilon_start:
            raise InputError(
                f"epsilon_end is {self.epsilon_end}: it must not exceed epsilon_start, {self.epsilon_start}."
            )

    def pheromone(self) -> PheromoneConfig:
        """Return the constants of the pheromone map."""
        # Here, since parsing a command line must not load what arenas need.
        from robosim.discretise.pheromone import PheromoneConfig

        return PheromoneConfig(
            decay=self.pheromone_decay,
            reinforcement=self.pheromone_reinforcement,
            diffusion=self.pheromone_diffusion,
            radius=self.pheromone_radius,
        )

    def epsilon(self, progress: float) -> float:
        """Return the share of random actions at `progress` (0 to 1) of a stage; it falls, then stays."""
        explored = 1.0 if self.exploration == 0.0 else min(1.0, progress / self.exploration)
        return self.epsilon_start + (self.epsilon_end - self.epsilon_start) * explored

    def epsilons(self, epsilon: float) -> NDArray[np.float64]:
        """Return the share of random actions in each environment, [envs], from that of the first.

        All but the first soon act almost greedily (Horgan 2018), so that experience holds what the finished
        team would do, standstill included.
        """
        place = np.arange(self.num_envs) / max(1, self.num_envs - 1)
        return np.asarray(epsilon ** (1.0 + self.epsilon_spread * place))

    def learning_rate_at(self, progress: float) -> float:
        """Return Adam's step size at `progress` (0 to 1) of a stage: it falls linearly."""
        return self.learning_rate * (1.0 + (self.learning_rate_end - 1.0) * min(1.0, progress))


_CHOICES = {
    "actions": ("cardinal", "wheels"),
    "encoding": ("paper", "expanded"),
    "sharing": ("copied", "split"),
    "newcomer": ("scratch", "copy"),
    "precision": ("float32", "bfloat16"),
}

_RANGES: dict[str, tuple[float, float]] = {
    "robots": (1, 1000),
    "steps": (1, 10**10),
    "seed": (0, 2**63 - 1),
    "num_envs": (1, 10_000),
    "pellet_gradient": (0.0, 50.0),
    "episode_steps": (0, 10**9),
    "learning_rate": (1e-8, 1.0),
    "learning_rate_end": (0.0, 1.0),
    "discount": (0.0, 0.99999),
    "return_steps": (1, 1000),
    "batch_size": (1, 65_536),
    "epsilon_start": (0.0, 1.0),
    "epsilon_end": (0.0, 1.0),
    "epsilon_spread": (0.0, 1000.0),
    "exploration": (0.0, 1.0),
    "replay_capacity": (1, 10**8),
    "warmup": (0, 10**10),
    "updates_per_step": (0.0, 1000.0),
    "target_interval": (1, 10**9),
    "reward_scale": (1e-6, 1e6),
    "first_team": (1, 1000),
    "fine_tune": (0.0, 0.99),
    "steady_gain": (0.0, 10.0),
    "checkpoint_every": (0, 10**10),
    "record_every": (0, 10**10),
    "record_steps": (1, 10**9),
    "evaluation_episodes": (0, 10_000),
    "evaluation_steps": (0, 10**9),
}


def write_config(config: TrainConfig, path: Path) -> None:
    """Write every field as TOML, so that the file alone repeats the run."""
    lines = [f"{name} = {_toml(value)}" for name, value in asdict(config).items()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_config(path: Path) -> TrainConfig:
    """Read a file that `write_config` wrote; a missing key takes its default, an unknown one is an error.

    InputError in one sentence for a file that cannot be read, is not TOML, or holds a wrong value.
    """
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}.") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a TOML file ({error}).") from error
    defaults = {field.name: field.default for field in fields(TrainConfig)}
    checked: dict[str, Any] = {}
    for name, value in values.items():
        if name not in defaults:
            raise InputError(f"{path}: unknown key {name!r}: {nearest_names(name, defaults)}")
        checked[name] = _like(value, defaults[name], f"{path}: {name}")
    try:
        return TrainConfig(**checked)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _like(value: object, default: object, place: str) -> object:
    if isinstance(default, tuple):
        if isinstance(value, list) and all(type(item) is int for item in value):
            return tuple(value)
        raise InputError(f"{place} is {value!r}: it must be a list of whole numbers.")
    if isinstance(default, float) and type(value) is int:
        return float(value)
    if type(value) is not type(default):
        kind = {str: "a text", bool: "true or false", int: "a whole number", float: "a number"}[type(default)]
        raise InputError(f"{place} is {value!r}: it must be {kind}.")
    return value


def _toml(value: object) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        plain = value.replace("\\", "\\\\").replace('"', '\\"')
        return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08X}" for c in plain) + '"'
    return repr(value)
