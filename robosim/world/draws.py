"""What an episode draws at random: starts, places of pellets, factors of the data sheet; for every world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robosim.arena.model import Arena, Randomisation
from robosim.equality import EqualByValue
from robosim.robot.kinematics import wrap_angle

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Draws(EqualByValue):
    """What an episode draws at random: starting poses, places of pellets, and factors of the data sheet."""

    robot_pose: Floats
    """[robots, 3]."""
    pellet_spot: Integers
    """[pellets] row of `arena.pellet_places`."""
    pellet_place: Floats
    """[pellets, 2] m."""
    robot_mass: Floats
    """[robots] factors."""
    traction: Floats
    """[robots] factors."""
    pellet_mass: Floats
    """[pellets] factors."""
    pellet_friction: Floats
    """[pellets] factors."""


def draw_pellets(
    arena: Arena, rng: np.random.Generator, gradient: float, clear: NDArray[np.bool_] | None = None
) -> Integers:
    """Draw the places where pellets lie as an episode begins, as rows [count] of `arena.pellet_places`.

    With `gradient` 0 all places are alike. Otherwise they lie more densely toward one side of the source,
    as they do once robots have dug for long: by a factor e ** strength from side to side, in a direction
    and of a strength up to `gradient` that are drawn first. Places that are not `clear` [places] are taken
    only where the others do not suffice.
    """
    places, count = arena.pellet_places, arena.pellets.count
    if gradient == 0.0:
        order = rng.permutation(len(places))
    else:
        angle, strength = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.0, gradient)
        low, span = places.min(axis=0), np.maximum(np.ptp(places, axis=0), arena.cell_size)
        along = ((places - low) / span) @ np.array([np.cos(angle), np.sin(angle)])
        # Whoever's exponential waiting time is over first is drawn first: in proportion to the density.
        order = np.argsort(rng.exponential(size=len(places)) * np.exp(-strength * along), kind="stable")
    if clear is not None:
        order = np.concatenate([order[clear[order]], order[~clear[order]]])
    return np.sort(order[:count])


def clear_of_robots(arena: Arena, pose: Floats) -> NDArray[np.bool_]:
    """Return at which of `arena.pellet_places` no pellet would touch a robot, however it is turned.

    `pose` is [robots, 3], the result [places].
    """
    reach = np.broadcast_to(arena.team(len(pose)).sheet.outer_radius, len(pose)) + arena.pellets.radius
    apart = arena.pellet_places[:, None] - pose[:, :2]
    return np.asarray((np.hypot(apart[..., 0], apart[..., 1]) >= reach).all(axis=1))


def room_apart(arena: Arena, distance: float) -> int:
    """Return for how many robots there are starts that are a distance (m) from each other."""
    if arena.start.poses:
        return arena.capacity
    return len(_picked(arena.start_places, np.arange(len(arena.start_places)), distance))


def _apart(arena: Arena, order: Integers, robots: int, distance: float) -> Integers:
    """Return starts [robots] that are a distance from each other, the earlier in `order` the sooner."""
    chosen = _picked(arena.start_places, order, distance)
    if len(chosen) < robots:
        # The first are in the way of too many others: as close together as they go, in the order drawn.
        packed = _picked(arena.start_places, np.arange(len(order)), distance)
        chosen = order[np.isin(order, packed)]
    return chosen[:robots]


def _picked(places: Floats, order: Integers, distance: float) -> Integers:
    """Return those of `order` that are a distance from all that were picked before them."""
    free = np.ones(len(places), dtype=np.bool_)
    picked = []
    for place in order.tolist():
        if free[place]:
            picked.append(place)
            free &= np.hypot(*(places - places[place]).T) >= distance
    return np.array(picked, dtype=np.int64)


def draw_episode(
    arena: Arena,
    robots: int,
    rng: np.random.Generator,
    pellet_gradient: float = 0.0,
    keep_distance: float | None = None,
    *,
    bodies: bool = False,
) -> tuple[Draws, Floats]:
    """Draw what is random in an episode; also returns the factors of the robots' top wheel speed [robots].

    Robots that keep a distance from each other (m) start at it. Where robots and pellets are `bodies`, none
    lies under another.
    """
    if arena.start.poses:
        pose = np.array(arena.start.poses[:robots])
        pose[:, 2] = wrap_angle(pose[:, 2])
    else:
        order = rng.permutation(len(arena.start_places))
        chosen = order[:robots] if keep_distance is None else _apart(arena, order, robots, keep_distance)
        heading = rng.uniform(-np.pi, np.pi, robots)
        pose = np.concatenate([arena.start_places[chosen], heading[:, None]], axis=1)
    count = arena.pellets.count
    spots = draw_pellets(arena, rng, pellet_gradient, clear_of_robots(arena, pose) if bodies else None)
    ranges: Randomisation = arena.randomisation
    draws = Draws(
        robot_pose=pose,
        pellet_spot=spots,
        pellet_place=arena.pellet_places[spots],
        robot_mass=rng.uniform(*ranges.robot_mass, robots),
        traction=rng.uniform(*ranges.traction, robots),
        pellet_mass=rng.uniform(*ranges.pellet_mass, count),
        pellet_friction=rng.uniform(*ranges.pellet_friction, count),
    )
    return draws, rng.uniform(*ranges.wheel_speed, robots)
