"""Write a policy as one ONNX file, and see that onnxruntime does with it what robosim does."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
from onnx import helper

import robosim
from robosim.control.environment import environment_for
from robosim.control.learned import LearnedController
from robosim.control.policy import WEIGHTS_FILE, Policy, read_policy
from robosim.deploy.graph import IR_VERSION, OPSET, policy_graph
from robosim.deploy.metadata import metadata
from robosim.deploy.runtime import Floats, OnnxPolicy

TOLERANCE = 1e-5
"""Largest difference between values of onnxruntime and of numpy that counts as agreement."""
_ENVS = 8
"""Side by side, where real observations are gathered."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """How far onnxruntime and robosim's numpy agree on the same observations."""

    observations: int
    """Of single robots."""
    other_actions: int
    """How many robots would act otherwise."""
    largest_difference: float
    """Between values; infinite where one of the two blocks a move and the other does not."""
    largest_value: float
    """By size, of those that are not blocked."""

    @property
    def holds(self) -> bool:
        """Whether all actions are the same and all values within `TOLERANCE`."""
        return self.other_actions == 0 and self.largest_difference <= TOLERANCE

    def __str__(self) -> str:
        actions = "the same actions" if self.other_actions == 0 else f"{self.other_actions} other actions"
        return (
            f"{actions} on {self.observations} observations, values up to {self.largest_value:.3g} within "
            f"{self.largest_difference:.1e}"
        )


def onnx_model(folder: Path, name: str = "") -> bytes:
    """Return a policy folder as an ONNX file; `name` is what its metadata call it, by default the folder's.

    Input and outputs are those of `robosim.deploy.graph.policy_graph`. Equal folders give equal bytes.
    InputError for a folder that is not a whole, sound policy.
    """
    policy = read_policy(folder)
    name = name or folder.resolve().name
    spec = policy.card.network
    weights = {key: array.astype(spec.precision) for key, array in policy.weights().items()}
    graph = policy_graph(spec, weights, policy.card.columns, name)
    model = helper.make_model(
        graph,
        producer_name="robosim",
        producer_version=robosim.__version__,
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
    )
    digest = hashlib.sha256((folder / WEIGHTS_FILE).read_bytes()).hexdigest()
    helper.set_model_props(model, metadata(policy.card, name, digest))
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString(deterministic=True))


def agreement(exported: OnnxPolicy, policy: Policy, observations: Floats) -> Agreement:
    """Return how far the two agree on observations [batch, robots, size]."""
    network, shape = policy.card.network, observations.shape[:2]
    decision = None if network.temperature is None else 0
    # Some that retreat already, and some that may begin to.
    retreats = None if network.retreat_in_place is None else np.arange(np.prod(shape)).reshape(shape) % 3
    left = None if retreats is None else retreats.copy()
    actions, values = exported.run(observations, decision, left)
    expected = policy.values(observations)
    blocked = np.isneginf(expected)
    difference = np.inf
    if values.shape == expected.shape and (np.isneginf(values) == blocked).all():
        difference = float(np.abs(values[~blocked] - expected[~blocked]).max())
    other = actions != policy.act(observations, decision, retreats)
    if left is not None:
        other |= left != retreats
    return Agreement(
        observations=int(np.prod(shape)),
        other_actions=int(other.sum()),
        largest_difference=difference,
        largest_value=float(np.abs(expected[~blocked]).max()),
    )


def real_observations(policy: Policy, name: str, count: int, seed: int = 0) -> Floats:
    """Return what the policy's team observes while it works, [batch, robots, size].

    In the environment on its card, at least `count` observations of single robots.
    """
    controller = LearnedController(policy, name)
    env = environment_for(controller, num_envs=_ENVS, seed=seed)
    observation = env.reset()
    controller.reset(env)
    decisions = -(-count // (_ENVS * env.robots))
    seen = []
    for _ in range(decisions):
        seen.append(observation)
        observation = env.step(controller.act(env, observation)).observation
    return np.concatenate(seen)
