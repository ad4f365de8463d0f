"""Options of a run that change nothing: they only matter beside another one, which is not there."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from robosim.envs.config import EnvConfig
from robosim.learning.config import RunConfig

_OF_CURRICULUM = {"first_team", "first_share", "newcomer", "fine_tune", "steady_gain"}


@dataclass(frozen=True, slots=True)
class IdleOption:
    """An option that changes nothing in a run."""

    name: str
    needs: str = ""
    """The option beside which it would matter; empty where there is no such one."""
    why: str = ""
    """Why it does not matter, where no option is named."""


def idle_options(config: RunConfig, given: Collection[str]) -> Iterator[IdleOption]:
    """Yield those of the given options, by name, that change nothing in a run of this configuration."""
    schedule, variety, run = config.schedule, config.variety, config.run
    of_map = {name for name, option in EnvConfig.options().items() if option.path[0] == "pheromone"}
    for names, matters, needs in (
        (_OF_CURRICULUM, schedule.curriculum, "curriculum"),
        (of_map, config.env.stigmergy, "stigmergy"),
        ({"record_steps"}, run.record_every, "record_every"),
        ({"arena_seed", "random_share"}, variety and variety.random_arenas, "random_arenas"),
    ):
        if not matters:
            yield from (IdleOption(name, needs=needs) for name in sorted(names & set(given)))
    explores = not schedule.start_from or (schedule.curriculum and schedule.newcomer == "scratch")
    joins = bool(schedule.start_from) or not schedule.curriculum or config.env.robots > schedule.first_team
    monotonic = getattr(config.algorithm, "mixer", "monotonic") == "monotonic"
    looked_at = run.evaluation_episodes > 0 or run.record_every > 0
    seen = config.env.encoding != "paper" or not getattr(config.algorithm, "mask", False)
    reasons: tuple[tuple[set[str], bool, str], ...] = (
        ({"epsilon_start", "exploration"}, explores, "with start_from, a team explores as at its end"),
        ({"first_team"}, not schedule.start_from, "with start_from, that team is the first"),
        ({"newcomer"}, joins, "the first team is the whole team, which nobody joins"),
        ({"evaluation_steps"}, run.evaluation_episodes > 0, "there are no episodes of evaluation"),
        ({"evaluation_profile"}, looked_at, "there are no episodes of evaluation"),
        ({"mask"}, seen, "the paper's encoding does not tell which moves are blocked"),
        ({"mixer_width", "hyper_width"}, monotonic, "a sum of values has no networks"),
    )
    for names, matters, why in reasons:
        if not matters:
            yield from (IdleOption(name, why=why) for name in sorted(names & set(given)))
