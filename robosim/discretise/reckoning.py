"""Dead reckoning: where robots take themselves to be, by fixes from outside and the turns of their wheels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robosim.robot.kinematics import moved_on, wrap_angle

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

PATIENCE = 3
"""So many fixes in turn that are far off are right, and the robot was wrong."""


class Reckoning:
    """Estimates the poses of robots, any batch of them, from late, lost and wild fixes and from odometry.

    A filter of constant gain. A fix is moved on by what the wheels have turned since it was made. One that is
    farther from the estimate than a robot drives between updates is not believed, unless several in turn are.
    A robot that touches something may slip, so it believes the fix and not its wheels.
    """

    def __init__(self, weight: float, travel: Floats | float, longest: int = 0) -> None:
        """Take the weight of a fix beside the estimate, from 0 to 1; the farthest that a robot comes from one
        update to the next, m, [robots] or of all; and by how many updates fixes may be late.
        """
        self._weight = weight
        self._travel = travel
        self._longest = longest
        self._odometry: list[Floats] = []
        """At the last updates, the newest at the end."""
        self._misses: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self.pose: Floats = np.zeros(0)
        """[..., 3] x m, y m, heading rad in [-pi, pi): the estimate, after the first update."""

    def update(
        self,
        fix: Floats,
        fresh: Bools,
        odometry: Floats,
        slips: Bools,
        age: NDArray[np.int64] | int = 0,
    ) -> Floats:
        """Return the poses [..., 3] at present.

        `fix` [..., 3] are the last poses that have arrived, `fresh` [...] those of them that did so since the
        last update, and `age` [...] the updates since these were made; `odometry` [..., 3] are the poses by
        the wheels alone at present, and `slips` [...] those who have touched something since the last update.
        The first update believes the fixes as they are. A fix that is not finite, of a robot that was not
        seen, is none; who has had none yet is unknown (NaN), and then at its first one.
        """
        seen = np.isfinite(fix).all(axis=-1)
        if not self.pose.size:
            self.pose = fix.copy()
            self._misses = np.zeros(fresh.shape, dtype=np.int64)
            self._odometry = [odometry.copy()]
            return self.pose
        expected = moved_on(self.pose, self._odometry[-1], odometry)
        self._odometry = [*self._odometry, odometry.copy()][-self._longest - 1 :]
        fresh = fresh & seen
        fixed = moved_on(fix, self._at(age, fresh.shape), odometry)
        off = fixed - expected
        off[..., 2] = wrap_angle(off[..., 2])
        far = np.hypot(off[..., 0], off[..., 1]) > self._travel
        lost = self._misses >= PATIENCE
        weight = np.where(slips | lost, 1.0, self._weight * ~far) * fresh
        off[~fresh] = 0.0
        self._misses = np.where(fresh, (self._misses + 1) * (weight == 0.0), self._misses)
        self.pose = expected + weight[..., None] * off
        unknown = fresh & ~np.isfinite(self.pose).all(axis=-1)
        self.pose[unknown] = fixed[unknown]
        self.pose[..., 2] = wrap_angle(self.pose[..., 2])
        return self.pose

    def _at(self, age: NDArray[np.int64] | int, shape: tuple[int, ...]) -> Floats:
        """Return the odometry [..., 3] of so many updates ago, or of the first update that is known."""
        back = np.minimum(np.broadcast_to(age, shape), len(self._odometry) - 1)
        history = np.stack(self._odometry[::-1])
        ago: Floats = np.take_along_axis(history, back[None, ..., None], axis=0)[0]
        return ago
