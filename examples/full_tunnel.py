"""A reward of one's own, with which the team for all learned not to pack a tunnel (docs/generality.md).

    ROBOSIM_PLUGINS=examples/full_tunnel.py robosim train --technique ps-ippo --extra-reward full --robots 16

While a tunnel holds more than 0.8 robots per cell of its length, who stands in it pays, and who stands
elsewhere gets back what standing costs: waiting until there is room costs nothing.
"""

import numpy as np
from numpy.typing import NDArray

from robosim.arena import Zone
from robosim.discretise.reward import Outcome, register_reward

DENSITY = 0.8
CHARGE = 1.0
STANDS = 0.1
"""Of the distance toward the goal that top speed gains."""
IDLE = 0.5
"""The most that is given back: what standing costs at the weights of the paper."""


def full(outcome: Outcome) -> NDArray[np.float64]:
    """Return what is paid in addition, [envs, robots]."""
    arena = outcome.setting.arena
    column, row = np.moveaxis((outcome.state.pose[..., :2] / arena.cell_size).astype(int), -1, 0)
    inside = arena.zones[row, column] == Zone.TUNNEL
    is_full = inside.sum(axis=1, keepdims=True) > DENSITY * max(arena.tunnel_length, 1)
    stands = np.abs(outcome.gained) < STANDS
    pay = np.where(inside, -CHARGE * stands, stands * np.clip(-outcome.reward, 0, IDLE))
    return np.where(is_full, pay, 0.0)


register_reward("full", full)
