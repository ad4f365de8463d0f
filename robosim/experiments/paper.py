"""What the paper reports: pellets delivered per episode, by method and size of the team."""

from __future__ import annotations

from collections.abc import Mapping

PELLETS: Mapping[str, tuple[int, ...]] = {
    "I-DQN": (43, 63, 99, 73, 79, 43, 32, 35),
    "I-A2C": (53, 69, 79, 49, 22, 8, 6, 3),
    "MA-DQN": (32, 15, 11, 8, 1, 2, 0, 0),
    "MA-A2C": (52, 36, 5, 0, 0, 0, 0, 0),
    "MADDPG": (33, 33, 17, 28, 3, 3, 1, 1),
    "MAPPO": (43, 99, 92, 57, 21, 22, 3, 2),
    "S-MADRL": (46, 87, 102, 115, 114, 105, 109, 110),
}
"""By method: for teams of 1 to 8 robots, in the paper's own grid world (its table of trips per episode)."""

TECHNIQUES: Mapping[str, str] = {
    "iql": "I-DQN",
    "ia2c": "I-A2C",
    "madqn": "MA-DQN",
    "maa2c": "MA-A2C",
    "maddpg": "MADDPG",
    "mappo": "MAPPO",
    "smadrl": "S-MADRL",
}
"""The paper's name of each technique here that stands in its table."""
