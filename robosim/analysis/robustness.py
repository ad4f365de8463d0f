"""How much a team still delivers as one thing after another goes wrong: each noise alone, at a few sizes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import Field

from robosim.control.card import Count, Evaluation
from robosim.control.controller import Controller
from robosim.control.evaluate import evaluate
from robosim.envs.profile import ProfileConfig
from robosim.envs.vector import VectorEnv
from robosim.errors import IncompleteError
from robosim.records import Many, Record
from robosim.world.factory import WorldKind

JAMMED = 0.1
"""A team that delivers at most this share of its pellets is jammed."""
_WILD = 0.15
"""Standard deviation of an outlier, m: about a cell."""
_LATE_ON_GRID = (1, 2, 3)
"""Decisions by which commands are late in the grid world, where nothing shorter makes a difference."""


@dataclass(frozen=True, slots=True)
class Noise:
    """One thing that goes wrong, and at which sizes."""

    name: str
    unit: str
    sizes: tuple[float, ...]
    options: Callable[[float], Mapping[str, Any]]
    """Options of a `ProfileConfig`, by short names, for a size."""


def _with_traction(lost: float) -> dict[str, Any]:
    left = round(1.0 - lost, 6)
    return {"motion_traction": (left, left)}


NOISES = (
    Noise("position noise", "m", (0.01, 0.03, 0.1), lambda size: {"sensing_position_noise": size}),
    Noise("heading noise", "rad", (0.05, 0.15, 0.5), lambda size: {"sensing_heading_noise": size}),
    Noise(
        "wild fixes",
        "probability",
        (0.02, 0.1, 0.3),
        lambda size: {"sensing_outliers": size, "sensing_outlier_size": _WILD},
    ),
    Noise("lost fixes", "probability", (0.1, 0.3, 0.6), lambda size: {"sensing_dropout": size}),
    Noise("rare fixes", "decisions skipped", (1, 3, 7), lambda size: {"sensing_update_every": int(size) + 1}),
    Noise("late fixes", "decisions", (1, 2, 4), lambda size: {"sensing_delay": int(size)}),
    Noise("late commands", "s", (0.05, 0.1, 0.2), lambda size: {"motion_latency": (size, size)}),
    Noise("jitter of commands", "s", (0.05, 0.1, 0.2), lambda size: {"motion_jitter": size}),
    Noise("motor lag", "s", (0.05, 0.15, 0.4), lambda size: {"motion_motor_lag": (size, size)}),
    Noise(
        "wheel mismatch",
        "share, +-",
        (0.05, 0.15, 0.4),
        lambda size: {"motion_wheel_mismatch": (-size, size)},
    ),
    Noise("lost traction", "share", (0.3, 0.6, 0.85), _with_traction),
    Noise("pheromone noise", "of 0 to 1", (0.05, 0.2, 0.5), lambda size: {"pheromones_additive_noise": size}),
    Noise("lost pheromones", "probability", (0.2, 0.5, 0.8), lambda size: {"pheromones_loss": size}),
    Noise("late pheromones", "decisions", (1, 3, 10), lambda size: {"pheromones_delay": int(size)}),
)
_ON_WHEELS = ("motion_motor_lag", "motion_wheel_mismatch", "motion_traction")
_LATE = ("motion_latency", "motion_jitter")


class Level(Record):
    """How a team did at one size of a noise."""

    size: float
    delivered: Many[Count]
    """[episodes] pellets of the team."""
    share: float
    """Mean of them over the mean without the noise."""
    error: float
    """Standard error of the share, over episodes; that of the mean without the noise left out."""


class Curve(Record):
    """How a team did as one noise grew."""

    noise: str
    unit: str
    levels: Many[Level]
    jams_at: float | None
    """The least size at which the team keeps at most `JAMMED` of its pellets; None where it does at none."""


class Robustness(Record):
    """What each noise alone costs a team."""

    controller: str
    arena: str
    world: WorldKind
    robots: int
    episode_steps: int
    seed: int
    profile: ProfileConfig | None = None
    """Under which each noise is tried; none for robots as their data sheet says."""
    delivered: Many[Count] = Field(min_length=1)
    """[episodes] pellets of the team without the noises."""
    curves: Many[Curve]


def noises_for(env: VectorEnv) -> tuple[Noise, ...]:
    """Return the noises that mean something to a team in `env`, at sizes that make a difference there."""
    return tuple(_meaningful(env))


def _meaningful(env: VectorEnv) -> Iterator[Noise]:
    on_grid, period = env.config.world == "grid", env.arena.timing.decision_period
    for noise in NOISES:
        option = next(iter(noise.options(noise.sizes[0])))
        if option.startswith("pheromones_") and not env.layout.patch:
            continue
        if on_grid and option in _ON_WHEELS:
            continue
        if on_grid and option in _LATE:
            sizes = tuple(round(count * period, 6) for count in _LATE_ON_GRID)
            yield Noise(noise.name, noise.unit, sizes, noise.options)
        else:
            yield noise


def require_pellets(reference: Evaluation) -> None:
    """Raise IncompleteError for a team that delivers nothing even without the noises."""
    if reference.mean == 0.0:
        raise IncompleteError(
            f"{reference.controller} delivers nothing even without noise, so there is no share to keep."
        )


def measure_robustness(
    controller: Controller,
    env: VectorEnv,
    reference: Evaluation,
    noises: Sequence[Noise],
    told: Callable[[str, Level], None] | None = None,
) -> Robustness:
    """Evaluate a controller under each noise alone, at every size; `reference` is its evaluation in `env`.

    All run the same number of episodes from the same seed. `told` hears of every size. IncompleteError where
    the team delivers nothing even without them.
    """
    require_pellets(reference)
    base = env.config.profile or ProfileConfig()
    curves = []
    for noise in noises:
        levels = []
        for size in noise.sizes:
            noisy = VectorEnv(
                env.config, num_envs=env.num_envs, profile=base.with_options(**noise.options(size))
            )
            found = evaluate(controller, noisy, reference.episodes, reference.seed)
            levels.append(_level(size, found, reference))
            if told is not None:
                told(noise.name, levels[-1])
        jams_at = next((level.size for level in levels if level.share <= JAMMED), None)
        curves.append(Curve(noise=noise.name, unit=noise.unit, levels=tuple(levels), jams_at=jams_at))
    return Robustness(
        controller=reference.controller,
        arena=reference.arena,
        world=reference.world,
        robots=reference.robots,
        episode_steps=reference.episode_steps,
        seed=reference.seed,
        profile=env.config.profile,
        delivered=reference.totals,
        curves=tuple(curves),
    )


def _level(size: float, found: Evaluation, reference: Evaluation) -> Level:
    return Level(
        size=float(size),
        delivered=found.totals,
        share=found.mean / reference.mean,
        error=found.std / found.episodes**0.5 / reference.mean,
    )


def table_of(found: Robustness) -> str:
    """Return the shares as a table in Markdown, a row for each noise."""
    widest, several = max(len(curve.levels) for curve in found.curves), len(found.delivered) > 1
    mean = sum(found.delivered) / len(found.delivered)
    about = (
        f"{found.controller} in {found.arena}, {found.robots} robots: share of {mean:.1f} pellets kept, "
        + ("mean +- standard error over " if several else "in ")
        + f"{len(found.delivered)} {'episodes' if several else 'episode'} of {found.episode_steps} decisions."
    )
    if found.profile is not None:
        about += f" Profile: {found.profile.called}; each size takes the place of what it says of that noise."
    lines = [
        about,
        "",
        "| noise | unit |" + " size: share |" * widest + " jams at |",
        "|---|---|" + "---|" * widest + "---|",
    ]
    for curve in found.curves:
        cells = [
            f"{level.size:g}: {level.share:.2f}" + (f" +- {level.error:.2f}" if several else "")
            for level in curve.levels
        ]
        cells += [""] * (widest - len(cells))
        jams = "none of these" if curve.jams_at is None else f"{curve.jams_at:g}"
        lines.append(f"| {curve.noise} | {curve.unit} | {' | '.join(cells)} | {jams} |")
    return "\n".join(lines) + "\n"
