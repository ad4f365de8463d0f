"""The rollout of algorithms that learn from what their present policy did, and then forget it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from robosim.errors import refused
from robosim.learning.algorithms.protocol import Experience
from robosim.learning.algorithms.stacked import part, prefixed


def stack_decisions(decisions: Sequence[Experience]) -> Experience:
    """Return decisions as one Experience of arrays [decisions, envs, ...]."""
    return Experience(*map(np.stack, zip(*decisions, strict=True)))


def rollout_state(decisions: Sequence[Experience]) -> dict[str, Tensor]:
    """Return copies of all that `restored_rollout` takes; nothing where there are no decisions."""
    if not decisions:
        return {}
    arrays = stack_decisions(decisions)._asdict()
    return prefixed("rollout.", {name: torch.from_numpy(array) for name, array in arrays.items()})


def restored_rollout(tensors: Mapping[str, Tensor]) -> list[Experience]:
    """Return the decisions of which `rollout_state` made some of these tensors."""
    held = part(tensors, "rollout.")
    if not held:
        return []
    arrays = (held[name].numpy() for name in Experience._fields)
    return [Experience(*decision) for decision in zip(*arrays, strict=True)]


def require_minibatches(minibatches: int, decisions: int) -> None:
    """Raise InputError unless a rollout of so many decisions, of all environments, has as many parts."""
    if minibatches > decisions:
        raise refused("minibatches", minibatches, f"a whole number from 1 to rollout * num_envs, {decisions}")
