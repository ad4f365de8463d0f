"""The lane keeper: a scripted controller with full knowledge of map and robots, our upper reference."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import GOALS, Arena, Zone
from robosim.control.routes import INBOUND, OUTBOUND, Routes, plan_routes
from robosim.control.seek import (
    Bools,
    Floats,
    Integers,
    cells_of,
    moves_blocked_by_robots,
    pellets_to_take,
    require_cardinal,
    toward_pellets,
)
from robosim.robot.drivers import CARDINAL_STEPS, STOP
from robosim.robot.team import Role

if TYPE_CHECKING:
    from robosim.envs.vector import VectorEnv

PATIENCE = 8
"""Decisions without motion after which a robot backs off."""
BACK_OFF = 5
"""Decisions for which it does; longer, and to other sides, each time that it has not helped."""
NO_HEADWAY = 24
"""Decisions of moving about without headway after which a robot backs off too."""
HEADWAY = 1.0
"""What counts as headway, in cells."""
REVERSE = np.array([1, 0, 3, 2, 4], dtype=np.int64)
"""[5] the opposite of each cardinal action."""


class LanesController:
    """Keeps right, yields to the robot ahead, takes turns in tunnels one robot wide, backs off when stuck."""

    name = "lanes"

    def __init__(self) -> None:
        self._arena: Arena | None = None
        self._routes: Routes

    def reset(self, env: VectorEnv) -> None:
        require_cardinal(self.name, env)
        if env.arena is not self._arena:
            self._arena = env.arena
            self._routes = plan_routes(env.arena)
        team = env.world.team
        self._first = 2 * team.group
        self._takes = np.array([GOALS[Role(role)][1] for role in team.role])
        shape = (env.num_envs, env.robots)
        self._waited = np.zeros(shape, dtype=np.int64)
        self._backing = np.zeros(shape, dtype=np.int64)
        self._escape = np.zeros(shape, dtype=np.int64)
        self._last = env.world.state.pose.copy()
        self._mark = self._last[..., :2].copy()
        self._since_mark = np.zeros(shape, dtype=np.int64)
        self._attempts = np.zeros(shape, dtype=np.int64)
        self._nearest = np.full(shape, np.inf)
        self._heading_out = np.zeros(shape, dtype=np.int64)
        self._gates = [[_Gate() for _ in range(self._routes.gates)] for _ in range(env.num_envs)]

    def act(self, env: VectorEnv, observation: NDArray[np.float32]) -> Integers:
        state, routes = env.world.state, self._routes
        cell = cells_of(env)
        row, column = cell[..., 1], cell[..., 0]
        heading_out = (state.held >= 0).astype(np.int64)
        if routes.gates:
            heading_out = self._follow_convoy(row, column, heading_out)
        steps = CARDINAL_STEPS[:4]
        leg = heading_out + self._first
        cost = routes.cost[leg[..., None], row[..., None] + steps[:, 1], column[..., None] + steps[:, 0]]
        # A long robot that turns in a tunnel wedges itself, so it keeps to the row that it is in.
        axis = routes.axis[leg, row, column]
        cost = np.where((axis[..., None] >= 0) & (np.arange(4) != axis[..., None]), np.inf, cost)
        here = routes.cost[leg, row, column]
        blocked = moves_blocked_by_robots(env)
        in_source = (routes.zones[row, column] == self._takes) & (heading_out == INBOUND)
        if in_source.any():
            cost = toward_pellets(env, in_source, cell, cost)
        wish = np.where(blocked, np.inf, cost)
        best = cost.argmin(axis=2)
        chosen = wish.argmin(axis=2)
        least = np.take_along_axis(wish, chosen[..., None], axis=2)[..., 0]
        # Around an obstacle sideways, never back: a queue waits. In a tunnel nobody leaves the lane.
        may_pass = (chosen == best) | (routes.zones[row, column] != Zone.TUNNEL)
        passable = may_pass & ((least <= here) | in_source) & np.isfinite(least)
        action = np.where(passable, chosen, STOP)
        if not env.world.team.all_round:
            # Who waits to be handed something stands still.
            action[in_source & ~pellets_to_take(env).any(axis=2)] = STOP
        if routes.gates:
            self._hold_at_gates(row, column, heading_out, best, action)
            self._clear_mouths(row, column, blocked, action)
        self._judge_headway(heading_out, here)
        return self._back_off(env, blocked, cost, best, action)

    def _back_off(
        self, env: VectorEnv, blocked: Bools, cost: Floats, best: Integers, action: Integers
    ) -> Integers:
        """Let robots that have stood still for long, and wanted to move, back off for some decisions."""
        pose = env.world.state.pose
        moved = np.abs(pose[..., :2] - self._last[..., :2]).sum(axis=2)
        turned = np.abs(np.sin(0.5 * (pose[..., 2] - self._last[..., 2])))
        self._last = pose.copy()
        still = (moved < 0.1 * env.world.travel) & (turned < 0.05)
        held_back = still & (self._held_at_gate_mask(env, action) == 0)
        self._waited = np.where(held_back, self._waited + 1, 0)
        # Robots lose patience one after the other, or two that block each other would mirror each other.
        patience = PATIENCE + 3 * np.arange(env.robots)
        fed_up = (self._waited > patience) | self._without_headway(env, action)
        fed_up &= self._backing == 0
        if fed_up.any():
            open_moves = np.where(blocked | ~np.isfinite(cost), -np.inf, cost)
            # Straight back first; when that has not helped, the next best moves away from the goal.
            order = np.argsort(-open_moves, axis=2, kind="stable")
            possible = np.isfinite(open_moves).sum(axis=2)
            which = self._attempts % np.maximum(possible - 1, 1)
            retreat = np.take_along_axis(order, which[..., None], axis=2)[..., 0]
            self._escape = np.where(fed_up, np.where(possible > 0, retreat, REVERSE[best]), self._escape)
            self._backing = np.where(fed_up, BACK_OFF + 2 * (self._attempts % 4), self._backing)
            self._waited = np.where(fed_up, 0, self._waited)
            self._attempts += fed_up
        action = np.where(self._backing > 0, self._escape, action)
        self._backing = np.maximum(self._backing - 1, 0)
        return action.astype(np.int64)

    def _judge_headway(self, heading_out: Integers, here: Floats) -> None:
        """Forget failed attempts to get free once a robot is nearer to its goal than ever on this trip."""
        turned = heading_out != self._heading_out
        self._attempts[turned | (here < self._nearest)] = 0
        self._nearest = np.where(turned, here, np.minimum(self._nearest, here))
        self._heading_out = heading_out

    def _without_headway(self, env: VectorEnv, action: Integers) -> Bools:
        """Return which robots have moved about for long and got nowhere, [envs, robots]."""
        place = env.world.state.pose[..., :2]
        far = ((place - self._mark) ** 2).sum(axis=2) > (HEADWAY * env.arena.cell_size) ** 2
        waits = (action == STOP) & (self._backing == 0)
        self._mark = np.where((far | waits)[..., None], place, self._mark)
        self._since_mark = np.where(far | waits, 0, self._since_mark + 1)
        tired = self._since_mark > NO_HEADWAY
        self._since_mark[tired] = 0
        return np.asarray(tired)

    def _held_at_gate_mask(self, env: VectorEnv, action: Integers) -> Integers:
        """Return where robots wait for a gate: they are patient, [envs, robots]."""
        if not self._routes.gates:
            return np.zeros_like(action)
        return self._waiting.astype(np.int64)

    def _follow_convoy(self, row: Integers, column: Integers, heading_out: Integers) -> Integers:
        """Inside a one-robot-wide tunnel everybody goes in the open direction, whatever they carry."""
        heading = heading_out.copy()
        inside = self._routes.gate[row, column]
        for env, robot in np.argwhere(inside >= 0).tolist():
            heading[env, robot] = self._gates[env][int(inside[env, robot])].direction
        return heading

    def _hold_at_gates(
        self, row: Integers, column: Integers, heading_out: Integers, best: Integers, action: Integers
    ) -> None:
        """Stop the robots that would enter a one-robot-wide tunnel out of turn; changes `action`."""
        routes = self._routes
        step = CARDINAL_STEPS[best]
        ahead_row, ahead_column = row + step[..., 1], column + step[..., 0]
        inside = routes.gate[row, column]
        near = np.maximum(routes.gate[ahead_row, ahead_column], routes.mouth[ahead_row, ahead_column])
        coming = (inside < 0) & (near >= 0) & (routes.zones[row, column] != Zone.TUNNEL)
        leg = heading_out + self._first
        closer = routes.cost[leg, ahead_row, ahead_column] < routes.cost[leg, row, column]
        # A robot that has just left the tunnel is near the mouth too, but its route leads off from it.
        entering = coming & closer & (self._tunnel_ahead(row, column, heading_out))
        self._waiting = np.zeros(action.shape, dtype=np.bool_)
        for env, gates in enumerate(self._gates):
            for number, gate in enumerate(gates):
                in_tunnel = inside[env] == number
                waiting = entering[env] & (near[env] == number)
                demand = [int((waiting & (heading_out[env] == one)).sum()) for one in (INBOUND, OUTBOUND)]
                gate.update(int(in_tunnel.sum()), demand, action.shape[1])
                refused = waiting & ((heading_out[env] != gate.direction) | (not gate.open))
                action[env, refused] = STOP
                self._waiting[env] |= refused

    def _clear_mouths(self, row: Integers, column: Integers, blocked: Bools, action: Integers) -> None:
        """Send the robots that wait in front of a mouth aside, so that others come out; changes `action`."""
        routes, steps = self._routes, CARDINAL_STEPS[:4]
        obstructs = self._waiting & (routes.mouth[row, column] >= 0)
        aside = routes.aside[row[..., None] + steps[:, 1], column[..., None] + steps[:, 0]]
        aside = np.where(blocked, np.inf, aside)
        best = aside.argmin(axis=2)
        useful = np.take_along_axis(aside, best[..., None], axis=2)[..., 0] < routes.aside[row, column]
        np.copyto(action, np.where(obstructs & useful, best, action))

    def _tunnel_ahead(self, row: Integers, column: Integers, heading_out: Integers) -> Bools:
        """Return whose goal lies beyond the tunnel: the source for inbound, the home for outbound robots."""
        routes = self._routes
        out, into = (routes.cost[self._first + one, row, column] for one in (OUTBOUND, INBOUND))
        near_home = out < into
        return np.asarray(np.where(heading_out == INBOUND, near_home, ~near_home))


class _Gate:
    """Priority in a tunnel one robot wide: one direction at a time, taking turns."""

    def __init__(self) -> None:
        self.direction = INBOUND
        self.open = True
        self._inside = 0
        self._admitted = 0

    def update(self, inside: int, demand: list[int], robots: int) -> None:
        """Take in how many robots are inside, and how many wait for each direction at the mouths."""
        self._admitted += max(0, inside - self._inside)
        self._inside = inside
        other = 1 - self.direction
        if demand[other] and (self._admitted >= math.ceil(robots / 2) or not demand[self.direction]):
            self.open = False
        if inside == 0 and (not self.open or not demand[self.direction]) and demand[other]:
            self.direction = other
            self.open = True
            self._admitted = 0
        elif inside == 0 and not demand[other]:
            self.open = True
            self._admitted = 0
