"""Techniques: named presets of options, those of the paper and ours."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from robosim.errors import InputError, nearest_names, shown

MANY_ROBOTS = 8
"""From as many robots on, a joint decision of a team brings so much experience that fewer updates do."""


@dataclass(frozen=True, slots=True)
class Technique:
    """A preset: which algorithm learns, and the options of a run in which it differs from their defaults."""

    name: str
    algorithm: str
    """By its name in the registry."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """By the short names of `run_config`: of the environment, of the algorithm, of the schedule."""
    about: str = ""
    """What it is, in a sentence."""
    with_wheels: Mapping[str, Any] = field(default_factory=dict)
    """Options besides, for teams that choose wheel speeds."""
    with_many: Mapping[str, Any] = field(default_factory=dict)
    """Options besides, for teams of `MANY_ROBOTS` and more."""

    def changed(self, name: str, /, **options: Any) -> Technique:
        """Return a technique of that name with some options different."""
        return replace(self, name=name, options={**self.options, **options}, about="")

    def options_with(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Return all options of a run for which `options` are asked for besides."""
        wheels = options.get("actions", self.options.get("actions", "cardinal")) != "cardinal"
        robots = options.get("robots", self.options.get("robots"))
        many = isinstance(robots, int) and robots >= MANY_ROBOTS
        return {
            **self.options,
            **(self.with_wheels if wheels else {}),
            **(self.with_many if many else {}),
            **options,
        }


_TEAM = {"reward": "global", "sharing": "split"}
"""Each robot is paid an equal part of what the team brings: the paper's reading by which teams learn."""
_LOCAL = {"reward": "local", "signed_distance": True}
"""Each robot is paid for what it does itself, and losing ground costs what gaining it pays."""
_SHARED = {**_LOCAL, "stigmergy": True, "idle_cost": True, "parameters": "shared", "mask": True}
"""All robots run one network, which does not choose blocked moves, and standing costs."""
_FAR = {"discount": 0.98, "learning_rate": 3e-3}
"""Wheels move a robot by little in a decision: it has to look further ahead (docs/wheels.md)."""
_SELDOM = {"updates_per_step": 0.25}
"""Half the updates bring as much, in less time (docs/results.md, eight robots by time)."""
_COPIED = {"newcomer": "copy", "fine_tune": 0.9}
"""With wheels even going straight has to be learned: newcomers that know how, and then all together."""
_MANY = {"num_envs": 32}
"""What learns from its present policy's decisions alone wants much of them at a time (Yu 2022)."""

TECHNIQUES: dict[str, Technique] = {}
_ALIASES = {"iql+gsc": "smadrl", "idqn": "iql"}


def register_technique(technique: Technique) -> Technique:
    """Make a technique known by its name, in the place of any that had it; returns it."""
    TECHNIQUES[technique.name] = technique
    return technique


def find_technique(name: str) -> Technique:
    """Return the technique of that name; InputError when there is none."""
    try:
        return TECHNIQUES[_ALIASES.get(name, name)]
    except KeyError:
        raise InputError(f"unknown technique {shown(name)}: {nearest_names(name, TECHNIQUES)}") from None


_OF_THE_PAPER = (
    Technique(
        "iql",
        "dqn",
        {"reward": "local", "stigmergy": False},
        "The paper's IQL, I-DQN in its table: own networks, own rewards.",
    ),
    Technique("iql+g", "dqn", {**_TEAM, "stigmergy": False}, "The paper's IQL+G: IQL, paid as a team."),
    Technique(
        "iql+gs", "dqn", {**_TEAM, "stigmergy": True}, "The paper's IQL+GS: IQL+G that sees pheromones."
    ),
    Technique(
        "smadrl",
        "dqn",
        {**_TEAM, "stigmergy": True, "curriculum": True},
        "The paper's S-MADRL, also IQL+GSC: IQL+GS, newcomers one by one.",
    ),
    Technique(
        "ia2c",
        "ia2c",
        {"reward": "local", "stigmergy": False},
        "The paper's I-A2C: an actor and a critic for each robot.",
    ),
    Technique(
        "madqn",
        "madqn",
        {**_TEAM, "stigmergy": False},
        "The paper's MA-DQN: one network chooses for all robots.",
    ),
    Technique(
        "maa2c",
        "maa2c",
        {**_TEAM, "stigmergy": False},
        "The paper's MA-A2C: one actor chooses for all robots.",
    ),
    Technique(
        "maddpg", "maddpg", {**_TEAM, "stigmergy": False}, "The paper's MADDPG, with discrete actions."
    ),
    Technique(
        "mappo",
        "ppo",
        {**_MANY, **_TEAM, "stigmergy": False, "critic": "team"},
        "The paper's MAPPO: PPO, with a critic that sees all robots.",
    ),
)
_OF_OTHERS = (
    Technique(
        "ippo",
        "ppo",
        {**_MANY, "reward": "local", "stigmergy": False},
        "IPPO (de Witt 2020): PPO, each robot by itself.",
    ),
    Technique(
        "vdn",
        "qmix",
        {**_TEAM, "stigmergy": False, "mixer": "sum"},
        "VDN (Sunehag 2018): values of robots add up to the team's.",
    ),
    Technique(
        "qmix",
        "qmix",
        {**_TEAM, "stigmergy": False},
        "QMIX (Rashid 2018): a network mixes values of robots into the team's.",
    ),
    Technique(
        "pqn",
        "pqn",
        {**_MANY, "reward": "local", "stigmergy": False},
        "PQN (Gallici 2025): Q-learning without replay.",
    ),
    Technique(
        "pqn-vdn",
        "pqn",
        {**_MANY, **_TEAM, "stigmergy": False, "mixer": "sum"},
        "PQN (Gallici 2025) with the sum of VDN.",
    ),
)
_OURS = (
    Technique(
        "smadrl+",
        "dqn",
        {
            **_TEAM,
            "signed_distance": True,
            "idle_cost": True,
            "stigmergy": True,
            "normalisation": "rms",
            "mask": True,
            "curriculum": True,
            "fine_tune": 0.7,
        },
        "Ours: the paper's four ideas (own networks, stigmergy, team reward, curriculum) with our learner.",
        {**_FAR, **_COPIED},
    ),
    # Without the noise of what others earn, and with no pay for going to and fro.
    Technique(
        "iql+s",
        "dqn",
        {**_LOCAL, "stigmergy": True},
        "Ours: IQL with pheromones; losing ground costs what gaining it pays.",
    ),
    Technique(
        "iql+sc",
        "dqn",
        {**_LOCAL, "stigmergy": True, "curriculum": True},
        "Ours: iql+s, newcomers one by one.",
    ),
    Technique(
        "ps-dqn",
        "dqn",
        {**_SHARED, "normalisation": "rms"},
        "Ours, the default: one network for all, normalised, which does not choose blocked moves.",
        _FAR,
        _SELDOM,
    ),
    Technique("ps-pqn", "pqn", {**_SHARED, **_MANY}, "Ours: ps-dqn without replay, by PQN."),
    Technique("ps-a2c", "ia2c", _SHARED, "Ours: ps-dqn with an actor and a critic, one of each for all."),
    Technique("ps-ippo", "ppo", {**_SHARED, **_MANY}, "Ours: ps-dqn by PPO."),
    Technique(
        "ps-ippo+",
        "ppo",
        {
            **_SHARED,
            **_MANY,
            "discount": 0.98,
            "learning_rate": 3e-3,
            "touch_cost": 0.3,
            "distance_weight": 0.05,
            "idle_weight": 0.2,
            "temperature": 0.3,
        },
        "Ours, for teams to use: ps-ippo that looks further ahead, is gentle, and draws its actions.",
    ),
    Technique(
        "ps-mappo",
        "ppo",
        {**_SHARED, **_MANY, "critic": "team"},
        "Ours: ps-ippo, with a critic that sees all robots.",
    ),
)
for _one in (*_OF_THE_PAPER, *_OF_OTHERS, *_OURS):
    register_technique(_one)
