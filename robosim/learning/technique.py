"""Techniques: named presets of options, those of the paper and ours."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from robosim.errors import InputError, nearest_names, shown


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

    def changed(self, name: str, /, **options: Any) -> Technique:
        """Return a technique of that name with some options different."""
        return Technique(name, self.algorithm, {**self.options, **options})


_TEAM = {"reward": "global", "sharing": "split"}
"""Each robot is paid an equal part of what the team brings: the paper's reading by which teams learn."""
_LOCAL = {"reward": "local", "signed_distance": True}
"""Each robot is paid for what it does itself, and losing ground costs what gaining it pays."""
_SHARED = {**_LOCAL, "stigmergy": True, "idle_cost": True, "parameters": "shared", "mask": True}
"""All robots run one network, which does not choose blocked moves, and standing costs."""
_MANY = {"num_envs": 32}
"""PPO learns from what its present policy did alone, so it wants much of that at a time (Yu 2022)."""

TECHNIQUES: dict[str, Technique] = {}
_ALIASES = {"iql+gsc": "smadrl"}


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


_SHIPPED = (
    Technique("iql", "dqn", {"reward": "local", "stigmergy": False}, "The paper's IQL."),
    Technique("iql+g", "dqn", {**_TEAM, "stigmergy": False}, "The paper's IQL+G."),
    Technique("iql+gs", "dqn", {**_TEAM, "stigmergy": True}, "The paper's IQL+GS."),
    Technique(
        "smadrl",
        "dqn",
        {**_TEAM, "stigmergy": True, "curriculum": True},
        "The paper's S-MADRL, IQL+GSC in its tables.",
    ),
    Technique("ia2c", "ia2c", {"reward": "local", "stigmergy": False}, "The paper's I-A2C."),
    Technique("maa2c", "maa2c", {**_TEAM, "stigmergy": False}, "The paper's MA-A2C."),
    Technique("mappo", "ppo", {**_TEAM, **_MANY, "stigmergy": False, "critic": "team"}, "The paper's MAPPO."),
    Technique(
        "ippo",
        "ppo",
        {**_MANY, "reward": "local", "stigmergy": False},
        "PPO with own rewards and critics, IPPO (de Witt 2020).",
    ),
    Technique(
        "madqn",
        "madqn",
        {**_TEAM, "stigmergy": False},
        "The paper's MA-DQN: one network chooses for all robots.",
    ),
    Technique(
        "vdn",
        "qmix",
        {**_TEAM, "stigmergy": False, "mixer": "sum"},
        "VDN: the team's value is the sum of the robots' values.",
    ),
    Technique(
        "qmix",
        "qmix",
        {**_TEAM, "stigmergy": False},
        "QMIX: the team's value grows with each robot's value.",
    ),
    Technique("pqn", "pqn", {"reward": "local", "stigmergy": False, "num_envs": 32}, "PQN, own networks."),
    Technique(
        "pqn-vdn",
        "pqn",
        {**_TEAM, "stigmergy": False, "num_envs": 32, "mixer": "sum"},
        "PQN with the team's value as the sum of the robots' values.",
    ),
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
            "fine_tune": 0.5,
        },
        "Ours: the paper's four ideas (own networks, stigmergy, team reward, curriculum) with our learner.",
    ),
    # Ours: without the noise of what others earn, and with no pay for going to and fro.
    Technique("iql+s", "dqn", {**_LOCAL, "stigmergy": True}, "Ours: own rewards, signed."),
    Technique(
        "iql+sc", "dqn", {**_LOCAL, "stigmergy": True, "curriculum": True}, "Ours: the same, one by one."
    ),
    Technique(
        "ps-dqn",
        "dqn",
        {**_SHARED, "normalisation": "rms"},
        "Ours: one network for all, normalised, which does not choose blocked moves.",
    ),
    Technique(
        "ps-a2c", "ia2c", _SHARED, "Ours: one actor and critic for all, which do not choose blocked moves."
    ),
    Technique("ps-ippo", "ppo", {**_SHARED, **_MANY}, "Ours: the same, by PPO."),
    Technique(
        "ps-mappo",
        "ppo",
        {**_SHARED, **_MANY, "critic": "team"},
        "Ours: the same, with a critic that sees all.",
    ),
)
for _one in _SHIPPED:
    register_technique(_one)
