"""The configuration of VDN and QMIX."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from robosim.learning.algorithms.dqn.config import DoubleQConfig
from robosim.learning.algorithms.protocol import Actors, Task
from robosim.learning.algorithms.values import OwnValuesConfig

if TYPE_CHECKING:
    from robosim.learning.algorithms.qmix.algorithm import Qmix


class QmixConfig(OwnValuesConfig, DoubleQConfig):
    """Value decomposition (VDN, Sunehag 2018; QMIX, Rashid 2018) with Double-Q targets and replay."""

    name: Literal["qmix"] = "qmix"
    """Of the algorithm."""
    parameters: Literal["own", "shared"] = "shared"
    """Each robot has a network of its own, or all act by one. A shared one does not see which robot it is, so
    it drives a team of any size."""
    mixer: Literal["sum", "monotonic"] = "monotonic"
    """How the robots' values make the team's: `sum` (VDN), or a network that grows with each of them, whose
    weights depend on what all robots observe (QMIX)."""
    mixer_width: int = Field(default=32, ge=1, le=4096)
    """Width of the monotonic mixer's hidden layer."""
    hyper_width: int = Field(default=64, ge=1, le=4096)
    """Width of the hidden layers of the networks that put out the monotonic mixer's weights."""
    gradient_norm: float = Field(default=10.0, ge=1e-6, le=1e6)
    """Most that the gradient of all that learns may measure; a longer one is shortened."""

    @property
    def needs_team(self) -> bool:
        return True

    def build(self, task: Task, seed: np.random.SeedSequence, start: Actors | None = None) -> Qmix:
        # Here, since reading a configuration must not load torch.
        from robosim.learning.algorithms.qmix.algorithm import Qmix

        return Qmix(self, task, seed, start)
