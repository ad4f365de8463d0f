"""`EnvConfig`: everything that an environment is, in one frozen record."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import Field

from robosim.arena import Arena, load_arena
from robosim.discretise.observation import Encoding, ObservationLayout
from robosim.discretise.pheromone import PheromoneConfig
from robosim.discretise.reward import RewardConfig
from robosim.envs.profile import CHANGED, ProfileConfig, load_profile
from robosim.errors import refused
from robosim.records import Record
from robosim.robot.drivers import ActionKind
from robosim.world.factory import WorldKind

MAX_PELLET_GRADIENT = 50.0
MOST_STEPS = 100_000_000
"""Decisions in an episode."""
LONGEST_ARENA = 1_000_000
"""Characters of an arena's text."""
MOST_CONFIG = 5_000_000
"""Bytes of a file that holds the configuration of a run."""


class EnvConfig(Record):
    """What an environment is: world, arena, team, actions, observations, rewards, starts and length.

    It goes whole into a run's configuration, a policy's card and a trajectory, and every face takes it or its
    fields. An option of the environment is a field here, and nowhere else.
    """

    world: WorldKind = "physics"
    """Rigid bodies (`physics`), or the paper's abstraction with one robot a cell (`grid`)."""
    arena: str = Field(default="paper", min_length=1, max_length=LONGEST_ARENA)
    """Arena by name, the path of its file, or the text of one."""
    robots: int = Field(default=4, ge=1, le=1000)
    """Size of the team."""
    actions: ActionKind = "cardinal"
    """What the actions are: toward the neighbouring cell, or wheel speeds, five or nine."""
    encoding: Encoding = "expanded"
    """How observations are written: the paper's eight numbers, or one-hot codes and more."""
    neighbours: bool = True
    """Whether the expanded encoding says which of the eight neighbouring cells are free: without it robots
    know of each other by pheromones alone."""
    stigmergy: bool = True
    """Whether robots see the pheromone map around them."""
    pheromone: PheromoneConfig = PheromoneConfig()
    """Constants of the pheromone map."""
    reward: RewardConfig = RewardConfig()
    """What a decision pays."""
    pellet_gradient: float = Field(default=0.0, ge=0, le=MAX_PELLET_GRADIENT)
    """How unevenly pellets may lie as an episode begins, as they do after long digging; 0 for evenly."""
    episode_steps: int = Field(default=0, ge=0, le=MOST_STEPS)
    """Decisions in an episode; 0 for as many as the arena says."""
    keep_distance: float | None = Field(default=None, gt=0, le=10)
    """m: robots slow down before their centres come nearer to each other than this, and turn or back off
    freely; none for robots that may touch."""
    profile: ProfileConfig | None = None
    """What is random and wrong about robots and what they perceive; none for nothing."""

    def layout_in(self, arena: Arena) -> ObservationLayout:
        """Return which number stands where in an observation, in that arena."""
        pheromone = self.pheromone
        return ObservationLayout(
            self.encoding,
            self.stigmergy,
            self.actions,
            pheromone.radius,
            pheromone.seen,
            self.neighbours,
            tuple(group.name for group in arena.groups),
        )


def env_config(base: EnvConfig | Arena | str | Path | None = None, **fields: Any) -> tuple[EnvConfig, Arena]:
    """Return the configuration and the arena that a face is asked for.

    `base` is a configuration, or the arena of one: a name, a file or an arena already read. `fields` replace
    fields of it, those of its rewards and pheromones by their short names (`reward="local"`,
    `signed_distance=True`, `pheromone_decay=0.2`); None leaves a field as it is. `profile` may be the name or
    the path of one, or a table. The configuration returned holds the arena's text, so that it is whole
    wherever it goes. Raises InputError.
    """
    fields = with_profile(fields)
    config, arena_of_base = (base, None) if isinstance(base, EnvConfig) else (EnvConfig(), base)
    places = (fields.pop("arena", None), arena_of_base, config.arena)
    given = next(place for place in places if place is not None)
    if not isinstance(given, str | Path | Arena):
        raise refused("arena", given, "a name, a path or an arena")
    # A name that nobody knows is a mistake even where its value is left open.
    config.require_options(fields)
    # The arena of an environment has its world's timing and starts, which must not get into another world.
    if isinstance(given, Arena) and not given.as_text:
        given = given.text
    arena = given if isinstance(given, Arena) else load_arena(given)
    config = config.with_options(**{name: value for name, value in fields.items() if value is not None})
    return config.changed(arena=arena.text), arena


def with_profile(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options with their `profile` as a record, given as name, path, text or table.

    Its name then says if other options change it, for results under it are not those under its name.
    """
    given = options.get("profile")
    if given is None:
        return dict(options)
    if isinstance(given, Mapping):
        profile = ProfileConfig.from_table(given, "profile")
    elif isinstance(given, str | Path):
        profile = load_profile(given)
    elif isinstance(given, ProfileConfig):
        profile = given
    else:
        raise refused("profile", given, "a profile, or the name, the path or the text of one")
    fields = ProfileConfig.options().keys() - {"name", "description"}
    if profile.name and any(options.get(name) is not None for name in fields):
        profile = profile.changed(name=f"{profile.name[:50]}{CHANGED}")
    return {**options, "profile": profile}
