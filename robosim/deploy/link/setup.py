"""What all processes of a team must agree on, and a number by which they notice when they do not."""

from __future__ import annotations

import hashlib
import json

from robosim.envs.config import EnvConfig


def setup_number(config: EnvConfig) -> int:
    """Return a number of the arena's text, the team's size, its actions and its pheromones."""
    facts = [config.arena, config.robots, config.actions, config.pheromone.model_dump(mode="json")]
    return int.from_bytes(hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).digest()[:8], "little")
