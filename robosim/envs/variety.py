"""Which arenas and team sizes a network sees that is to drive teams of any size anywhere."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from robosim.arena import Arena, arena_names, load_arena
from robosim.arena.random import ROOM, random_arena
from robosim.envs.config import LONGEST_ARENA
from robosim.errors import InputError
from robosim.records import Many, Record

LOOKED_AT = 100
"""Random arenas in turn among which one with room is looked for; in the grid one in four has room for 32."""


class VarietyConfig(Record):
    """Several arenas and team sizes at once, for one network that all robots run.

    The environments are shared out to groups of `envs_per_arena`; a group keeps its team size and draws its
    arena.
    """

    arenas: Many[Annotated[str, Field(min_length=1, max_length=LONGEST_ARENA)]] = Field(
        default=(), max_length=1000
    )
    """Arenas to learn in, each by name, the path of its file, or the text of one."""
    random_arenas: int = Field(default=0, ge=0, le=10**9)
    """How many random arenas there are besides, those of the seeds `arena_seed` and on."""
    arena_seed: int = Field(default=0, ge=0, le=2**62)
    """Seed of the first random arena (`robosim arena random --seed` shows it); the next one has the next."""
    random_share: float = Field(default=0.5, ge=0, le=1)
    """Share of the groups that are in random arenas, where there are both kinds."""
    team_sizes: Many[Annotated[int, Field(ge=1, le=1000)]] = Field(
        default=(1, 2, 4, 8), min_length=1, max_length=1000
    )
    """Sizes of the teams, shared out evenly to the groups."""
    envs_per_arena: int = Field(default=2, ge=1, le=4096)
    """Environments of a group, in the same arena; more cost less time each, and show fewer arenas at once."""
    redraw: int = Field(default=1, ge=0, le=10**9)
    """Episodes after which the groups draw their arenas anew; 0 for never."""

    @model_validator(mode="after")
    def _check_arenas(self) -> Self:
        if not self.arenas and not self.random_arenas:
            raise ValueError("arenas is empty and random_arenas is 0, but one of them must be there")
        if self.random_arenas and max(self.team_sizes) > ROOM:
            raise ValueError(
                f"team_sizes holds {max(self.team_sizes)}, but must hold at most {ROOM} with random arenas"
            )
        return self

    def self_contained(self) -> Self:
        """Return this configuration with the text of each arena that does not ship."""
        shipped = arena_names()
        arenas = (arena if arena in shipped else load_arena(arena).text for arena in self.arenas)
        return self.changed(arenas=tuple(arenas))

    def sizes(self, groups: int, seed: Sequence[int]) -> tuple[int, ...]:
        """Return the team size of each group."""
        rng = np.random.default_rng(np.random.SeedSequence(seed))
        each = np.resize(np.array(self.team_sizes), groups)
        # In no order: the first environments explore most, whoever is in them.
        return tuple(map(int, rng.permutation(each)))

    def draw(
        self, groups: int, seed: Sequence[int], episode: int, has_room: Callable[[str], bool]
    ) -> list[str]:
        """Return the text or name of each group's arena in an episode; equal arguments give equal arenas.

        Random ones are those that `has_room` says yes to; InputError as in `random`.
        """
        times = episode // self.redraw if self.redraw else 0
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(times,)))
        drawn = self._random_groups(groups)
        listed = [
            self.arenas[int(place)]
            for _ in range(-(-groups // max(1, len(self.arenas))))
            for place in rng.permutation(len(self.arenas))
        ]
        numbers = rng.integers(self.random_arenas, size=drawn) if drawn else ()
        chosen = [self.random(int(number), has_room) for number in numbers]
        chosen += listed[: groups - drawn]
        return [chosen[int(place)] for place in rng.permutation(groups)]

    def random(self, number: int, has_room: Callable[[str], bool]) -> str:
        """Return the text of a random arena by its number, or of the next one after it that has room.

        InputError where none of `LOOKED_AT` in turn has.
        """
        for later in range(LOOKED_AT):
            text = random_arena(self.arena_seed + (number + later) % self.random_arenas)
            if has_room(text):
                return text
        raise InputError(
            f"random_arenas: none of {LOOKED_AT} in turn has room for {max(self.team_sizes)} robots, as "
            "team_sizes says, in this world and at this keep_distance."
        )

    def _random_groups(self, groups: int) -> int:
        """Return how many groups are in random arenas; a share between 0 and 1 leaves one for each kind."""
        share = self.random_share if self.arenas else 1.0
        if not self.random_arenas or share == 0.0:
            return 0
        if share == 1.0 or groups == 1:
            return round(groups * share)
        return min(groups - 1, max(1, round(groups * share)))


def require_alike(arena: Arena, base: Arena) -> None:
    """Raise InputError unless observations mean the same in `arena` as in `base`."""
    for what, given, wanted in (
        ("cell_size", arena.cell_size, base.cell_size),
        ("robot", arena.robot, base.robot),
        ("groups", arena.groups, base.groups),
        ("timing", arena.timing, base.timing),
    ):
        if given != wanted:
            raise InputError(
                f"arenas: {what} of {arena.name} is {given}, but must be {wanted}, as in {base.name}: one "
                "network is to drive in all of them."
            )
