"""The paper's learning techniques: independent Q-learning, and what each adds to it."""

from __future__ import annotations

from dataclasses import dataclass

from robosim.errors import InputError, nearest_names


@dataclass(frozen=True, slots=True)
class Technique:
    """Which of the paper's additions to independent Q-learning are on."""

    name: str
    global_reward: bool
    """Pickup and delivery are paid to every robot instead of the one that did it."""
    stigmergy: bool
    """Robots see the pheromone map around them."""
    curriculum: bool
    """Newcomers join one at a time, while the robots before them stay frozen."""


TECHNIQUES = {
    technique.name: technique
    for technique in (
        Technique("iql", global_reward=False, stigmergy=False, curriculum=False),
        Technique("iql+g", global_reward=True, stigmergy=False, curriculum=False),
        # Ours, not the paper's: stigmergy without the noise of what others earn.
        Technique("iql+s", global_reward=False, stigmergy=True, curriculum=False),
        Technique("iql+gs", global_reward=True, stigmergy=True, curriculum=False),
    )
}


def find_technique(name: str) -> Technique:
    """Return the technique of that name; InputError when there is none."""
    try:
        return TECHNIQUES[name]
    except KeyError:
        raise InputError(f"unknown technique {name!r}: {nearest_names(name, TECHNIQUES)}") from None
