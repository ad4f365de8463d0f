"""Techniques: which of the paper's additions to independent Q-learning (IQL) are on."""

from __future__ import annotations

from dataclasses import dataclass

from robosim.errors import InputError, nearest_names


@dataclass(frozen=True, slots=True)
class Technique:
    """Switches on top of independent Double DQN (the paper's section on the experimental setup)."""

    name: str
    global_reward: bool
    """Pickup and delivery are paid to every robot instead of the one that did it."""
    stigmergy: bool
    """Robots see the pheromone map around them."""
    curriculum: bool
    """Newcomers join one at a time, while the robots before them stay frozen."""
    signed_distance: bool = False
    """Losing ground costs what gaining it pays; the paper pays for gains alone, so going to and fro pays."""
    idle_cost: bool = False
    """A decision without making way costs what one at top speed pays; the paper fines robots that meet, but
    not those that then wait for each other for ever."""
    parameter_sharing: bool = False
    """All robots act by one network, which learns from what each of them does (Gupta 2017)."""
    normalised: bool = False
    """What a hidden layer puts out is divided by its root mean square (Zhang 2019): no state, however rare,
    is valued far above the others."""
    action_mask: bool = False
    """Robots do not choose ways that end at a wall or lead away from both goals, where their actions are
    cardinal and their observations tell."""

    def __post_init__(self) -> None:
        """Check that the switches go together; InputError if not."""
        if self.curriculum and self.parameter_sharing:
            raise InputError(
                f"technique {self.name!r}: one network for all cannot be frozen beside itself, so "
                "parameter_sharing and curriculum must not both be True."
            )


TECHNIQUES = {
    technique.name: technique
    for technique in (
        Technique("iql", global_reward=False, stigmergy=False, curriculum=False),
        Technique("iql+g", global_reward=True, stigmergy=False, curriculum=False),
        Technique("iql+gs", global_reward=True, stigmergy=True, curriculum=False),
        # IQL+GSC in the paper's tables.
        Technique("smadrl", global_reward=True, stigmergy=True, curriculum=True),
        # Ours, not the paper's: without the noise of what others earn, and with no pay for dithering.
        Technique("iql+s", global_reward=False, stigmergy=True, curriculum=False, signed_distance=True),
        Technique("iql+sc", global_reward=False, stigmergy=True, curriculum=True, signed_distance=True),
        Technique(
            "ps-dqn",
            global_reward=False,
            stigmergy=True,
            curriculum=False,
            signed_distance=True,
            idle_cost=True,
            parameter_sharing=True,
            normalised=True,
            action_mask=True,
        ),
    )
}
_ALIASES = {"iql+gsc": "smadrl"}


def find_technique(name: str) -> Technique:
    """Return the technique of that name; InputError when there is none."""
    try:
        return TECHNIQUES[_ALIASES.get(name, name)]
    except KeyError:
        raise InputError(f"unknown technique {name!r}: {nearest_names(name, TECHNIQUES)}") from None
