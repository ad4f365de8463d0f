"""What a robot sees and does, as Gymnasium's spaces."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete

from robosim.discretise.observation import ObservationLayout


def robot_spaces(layout: ObservationLayout) -> tuple[Box[Any], Discrete[np.int64]]:
    """Return the space of a robot's observations, float32 [size], and that of its actions."""
    return Box(layout.low, layout.high, dtype=np.float32), Discrete(layout.num_actions)
