"""Where everything lies in a recording: the entity paths and the timelines."""

from __future__ import annotations

STEP = "step"
"""Timeline: decision within the episode."""
TIME = "sim_time"
"""Timeline: simulated time since the episode began."""

ARENA = "arena"
MAP = "arena/map"
WALLS = "arena/walls"
ZONES = "arena/zones"
PHEROMONE = "arena/pheromone"
LOOSE = "arena/pellets/loose"
HELD = "arena/pellets/held"
TRACKS = "arena/tracks"
CONTACTS = "arena/contacts"
CLOGS = "arena/clogs"
DELIVERED = "plots/delivered"
DELIVERED_BY_ROBOT = "plots/delivered_by_robot"
DENSITY = "plots/tunnel_density"
REWARD = "plots/reward"
LEARNING = "learning"
TARGETS = "arena/targets"
WHEELS = "arena/wheels"
LEFT_SPEED = "plots/wheels/left"
RIGHT_SPEED = "plots/wheels/right"
AGE = "plots/age"
DECIDED = "decided"
TOUCHED = "touched"
STOPS = "stops"
STOP_LOG = "log/stops"
GRIPPER_LOG = "log/grippers"
COLLISION_LOG = "log/collisions"
DELIVERY_LOG = "log/deliveries"
CLOG_LOG = "log/clogs"
LEGEND = "legend"
SWATCHES = "legend/swatches"
NAMES = "legend/names"
ABOUT = "about"


def learning(name: str) -> str:
    """Return the path of a curve of a training."""
    return f"{LEARNING}/{name}"


def robot(index: int) -> str:
    """Return the path of a robot's body; below it lie `body`, `outline`, `heading`, `name` and `clog`."""
    return f"arena/robots/{index}"


def mode(index: int) -> str:
    """Return the path of a robot's mode."""
    return f"modes/robot_{index}"


def lane(kind: str, index: int) -> str:
    """Return the path of a robot's lane of one kind: `DECIDED`, `TOUCHED` or `STOPS`."""
    return f"{kind}/robot_{index}"


def ring(index: int) -> str:
    """Return the path of the ring round a robot that is in a clog, or stopped by its controller."""
    return f"{robot(index)}/clog"


def clogs(lane: int) -> str:
    """Return the path of a lane of clogs; those at the same time lie in lanes of their own, from 0."""
    return "modes/clogs" if lane == 0 else f"modes/clogs_{lane + 1}"
