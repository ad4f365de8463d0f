"""Teams without a plan for their traffic: the protocols Active, Reversal and Lorenz of excavating robots.

After Aguilar et al. 2018, "Collective clog control: Optimizing traffic flow in confined biological and
robophysical excavation", Science 361, 672-677. There, Active robots always go; Reversal robots give up and
turn round with a small probability when they have not reached the face within a set time; each Lorenz robot
has its own probability to go again. Numbers that this leaves open are ours, and are marked so below.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Arena, Zone
from robosim.control.routes import NEAR_WALL_COST, costs_to, cramped_cells
from robosim.control.seek import (
    Bools,
    Floats,
    Integers,
    cells_of,
    moves_blocked_by_robots,
    require_all_round,
    require_cardinal,
    toward_pellets,
)
from robosim.robot.drivers import CARDINAL_STEPS, STOP
from robosim.world.contacts import ContactKind

if TYPE_CHECKING:
    from robosim.envs.vector import VectorEnv

WEDGED = 8
"""Decisions in one place, held by walls and pellets alone, after which a robot frees itself; ours."""
FREEING = 4
"""Decisions that it takes for that; ours."""
SLIP = 0.5
"""Where robots stand on cells, the probability to try a side at which a robot ahead might be passed; ours."""
GIVE_UP = 0.34
"""Probability to give up each time that the time for the route runs out, from the cellular automaton."""
SLACK = 1.5
"""Time for the route to the source, in times of what it takes at top speed; ours."""
TURNS = 10
"""Time for turns that is added to it, in decisions; ours."""
GINI = 0.74
"""Gini coefficient of the ants' workload."""
STEEPNESS = 2.0 * GINI / (1.0 - GINI)
"""a: probabilities u^a at ranks u spread evenly over 0 to 1 have the Gini coefficient a / (a + 2)."""
HOME, SOURCE, ASIDE = range(3)
"""What a robot can be headed for; `ASIDE` is in the home, as far from the tunnel as there is room."""


class ActiveController:
    """Every robot always goes, by the shortest route: no lanes, no yielding, no backing off.

    A robot that is wedged between walls and pellets, and touches no other, tries another move for a while,
    drawn at random. That clears no traffic, but without it a long robot on its own ends its work at
    the mouth of a tunnel.

    Round robots that press on each other slip past where there is room. Where they stand on cells, that takes
    a step aside, which a robot tries by chance as long as another refuses its move.
    """

    name = "active"

    def __init__(self, seed: int = 0) -> None:
        self._seed = seed
        self._arena: Arena | None = None
        self._zones: NDArray[np.uint8]
        self._costs: Floats

    def reset(self, env: VectorEnv) -> None:
        require_cardinal(self.name, env)
        require_all_round(self.name, env)
        if env.arena is not self._arena:
            self._arena = env.arena
            self._zones = np.pad(env.arena.zones, 1, constant_values=int(Zone.WALL))
            self._costs = _costs_to_goals(env.arena, self._zones)
        # One generator an environment, so that a batch acts as its members would alone.
        self._rngs = [
            np.random.default_rng(np.random.SeedSequence((self._seed, seed, env.episode)))
            for seed in env.seeds
        ]
        shape = (env.num_envs, env.robots)
        self._freeing = np.zeros(shape, dtype=np.int64)
        self._escape = np.full(shape, STOP, dtype=np.int64)

    def act(self, env: VectorEnv, observation: NDArray[np.float32]) -> Integers:
        cell = cells_of(env)
        row, column = cell[..., 1], cell[..., 0]
        zone = self._zones[row, column]
        laden = env.world.state.held >= 0
        goal = self._goals(zone, laden, self._costs[SOURCE, row, column])
        steps = CARDINAL_STEPS[:4]
        cost = self._costs[goal[..., None], row[..., None] + steps[:, 1], column[..., None] + steps[:, 0]]
        digging = ~laden & (goal == SOURCE) & (zone == Zone.SOURCE)
        if digging.any():
            cost = toward_pellets(env, digging, cell, cost)
        nearer = cost < self._costs[goal, row, column][..., None]
        possible = np.isfinite(cost)
        wish = np.where(nearer | digging[..., None], cost, np.inf)
        aside = goal == ASIDE
        if aside.any():
            wish = np.where(aside[..., None] & moves_blocked_by_robots(env), np.inf, wish)
        action = np.where(np.isfinite(wish).any(axis=2), wish.argmin(axis=2), STOP)
        return self._freed(env, possible, action)

    def _goals(self, zone: NDArray[np.uint8], laden: Bools, distance: Floats) -> Integers:
        """Return what the robots are headed for, [envs, robots]; `distance` is to the source, in cells."""
        return np.where(laden, HOME, SOURCE)

    def _freed(self, env: VectorEnv, possible: Bools, action: Integers) -> Integers:
        """Return the actions, those of robots that free themselves changed; `possible` moves meet no wall."""
        if env.world.on_cells:
            return self._slipping(env, possible, action)
        robot, wall, pellet = env.world.state.touched
        wedged = (env.dec_pomdp.in_place > WEDGED) & (wall | pellet) & ~robot
        wedged &= (action != STOP) & (self._freeing == 0)
        if wedged.any():
            others = np.arange(4) != action[..., None]
            escape = np.where(possible & others, self._draw(wedged, 4), 2.0).argmin(axis=2)
            self._escape = np.where(wedged, escape, self._escape)
            self._freeing = np.where(wedged, FREEING, self._freeing)
        action = np.where(self._freeing > 0, self._escape, action)
        self._freeing = np.maximum(self._freeing - 1, 0)
        return action

    def _slipping(self, env: VectorEnv, possible: Bools, action: Integers) -> Integers:
        """Return the actions, those of robots that try to get past another one changed to a side."""
        refused = env.world.state.touched[ContactKind.ROBOT_ROBOT] & (action != STOP)
        if not refused.any():
            return action
        # North and south are at the sides of west and east.
        sideways = possible & (np.arange(4) // 2 != action[..., None] // 2)
        drawn = np.where(sideways, self._draw(refused, 4), 1.0)
        return np.where(refused & (drawn.min(axis=2) < SLIP), drawn.argmin(axis=2), action)

    def _draw(self, needed: Bools, *size: int) -> Floats:
        """Return numbers from [0, 1), [envs, robots, *size], drawn where an environment needs any."""
        drawn = np.ones((*needed.shape, *size))
        for env in np.flatnonzero(needed.any(axis=1)):
            drawn[env] = self._rngs[env].random(drawn.shape[1:])
        return drawn


class _RestingController(ActiveController):
    """As `active`, with robots that rest at times: at home, as far from the tunnel as there is room."""

    def reset(self, env: VectorEnv) -> None:
        super().reset(env)
        self._cell_time = env.arena.cell_size / env.world.travel
        shortest = float(self._costs[SOURCE][self._zones == Zone.HOME].min())
        each = np.broadcast_to(2.0 * shortest * self._cell_time, env.robots)
        self._round_trip = np.ceil(each).astype(np.int64)
        """[robots] decisions."""
        # Decisions left of each robot's rest; they count in the home only, and a laden robot rests no more.
        self._rest = np.zeros((env.num_envs, env.robots), dtype=np.int64)

    def _goals(self, zone: NDArray[np.uint8], laden: Bools, distance: Floats) -> Integers:
        in_home = zone == Zone.HOME
        rested = in_home & (self._rest == 1)
        self._rest = np.where(laden, 0, self._rest - (in_home & (self._rest > 0)))
        begins = self._begins_rest(zone, laden, distance, rested)
        self._rest = np.where(begins, self._round_trip, self._rest)
        rests = self._rest > 0
        return np.where(laden | (rests & ~in_home), HOME, np.where(rests, ASIDE, SOURCE))

    def _begins_rest(self, zone: NDArray[np.uint8], laden: Bools, distance: Floats, rested: Bools) -> Bools:
        """Return who is to rest from now on; `rested` has just done so; [envs, robots]."""
        raise NotImplementedError


class ReversalController(_RestingController):
    """As `active`, but a robot that has not reached the source in time may give up and turn round.

    The time is that of the free route, with some slack. Each time that it runs out, the robot gives up with
    probability `GIVE_UP`, or else has the time of what is left of it. Who has given up drives
    home, rests there for the time of a free round trip, or the next ones would find it in front of
    them again, and tries anew.
    """

    name = "reversal"

    def reset(self, env: VectorEnv) -> None:
        super().reset(env)
        shape = (env.num_envs, env.robots)
        self._under_way = np.zeros(shape, dtype=np.bool_)
        self._time_left = np.zeros(shape)

    def _begins_rest(self, zone: NDArray[np.uint8], laden: Bools, distance: Floats, rested: Bools) -> Bools:
        under_way = ~laden & (self._rest == 0) & (zone != Zone.SOURCE)
        self._time_left -= 1
        late = under_way & self._under_way & (self._time_left <= 0)
        gives_up = np.asarray(late & (self._draw(late) < GIVE_UP))
        time = TURNS + SLACK * self._cell_time * distance
        self._time_left = np.where(under_way & (late | ~self._under_way), time, self._time_left)
        self._under_way = under_way & ~gives_up
        return gives_up


class LorenzController(_RestingController):
    """As `active`, but each robot has its own probability to go again when it is home.

    Robot i of n, from 0, goes with probability ((n - i) / n)^a, a = `STEEPNESS`: the first one always, the
    last ones next to never; in a large team, the Gini coefficient is `GINI`. Who does not go rests for the
    time of a free round trip, then draws again, so that its work is proportional to its probability.
    """

    name = "lorenz"

    def reset(self, env: VectorEnv) -> None:
        super().reset(env)
        self._probability = lorenz_probabilities(env.robots)
        self._away = np.zeros((env.num_envs, env.robots), dtype=np.bool_)
        self._rest = np.where(self._stays(~self._away), self._round_trip, 0)

    def _begins_rest(self, zone: NDArray[np.uint8], laden: Bools, distance: Floats, rested: Bools) -> Bools:
        draws = (zone == Zone.HOME) & ~laden & (self._away | rested)
        self._away = (self._away | laden) & ~draws
        return self._stays(draws)

    def _stays(self, draws: Bools) -> Bools:
        """Return which of those who draw are not to go, [envs, robots]."""
        return np.asarray(draws & (self._draw(draws) >= self._probability))


def lorenz_probabilities(robots: int) -> Floats:
    """Return the probabilities to go again of a team of `robots`, [robots], falling."""
    ranks = np.arange(robots, 0, -1, dtype=np.float64) / robots
    return np.asarray(ranks**STEEPNESS)


def _costs_to_goals(arena: Arena, zones: NDArray[np.uint8]) -> Floats:
    """Return what is to fall on the route to each goal, [3, rows + 2, columns + 2]; inf in walls.

    For home and source, the shortest route over cells, in cells, that leaves a long robot room to turn; for
    `ASIDE`, which is inf outside the home too, less the distance to the source in m.
    """
    free, home = zones != Zone.WALL, zones == Zone.HOME
    largest = max((group.sheet for group in arena.team(1).groups), key=lambda sheet: sheet.outer_radius)
    fee = np.where(
        cramped_cells(largest, arena.cell_size, free) & (zones != Zone.TUNNEL), NEAR_WALL_COST, 1.0
    )
    rows, columns = zones.shape
    middles = np.stack(np.meshgrid(np.arange(columns) - 0.5, np.arange(rows) - 0.5), axis=2)
    to_source = arena.distances.sample(middles * arena.cell_size)[..., 1]
    aside = np.where(home, -to_source, np.inf)
    return np.stack([costs_to(free, home, fee), costs_to(free, zones == Zone.SOURCE, fee), aside])
