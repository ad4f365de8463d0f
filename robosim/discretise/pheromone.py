"""The pheromone map: a virtual memory of the arena that robots write to and read around them."""

from __future__ import annotations

from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from robosim.discretise.cells import Grid
from robosim.records import Record

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

Seen = Literal["all", "patch", "density"]

CHANNELS = ("occupancy", "mode", "laden", "action")
# From 1 over the number of kinds up to 1, so that no mark looks like none.
_MODE_MARKS = np.arange(1.0, 8.0) * (1.0 / 7.0)

QUARTERS = 4
"""Of a turn."""
_QUARTER_LEFT = np.array([[0, 1], [-1, 0]])
"""Rows (column, row) times this are turned to the left by a quarter."""

SLOWEST = 1e-6
"""Least decay and reinforcement: with none, a map would have no saturation to be read against."""
FASTEST_DIFFUSION = 0.2
"""So a cell with four neighbours keeps at least what it gives to each of them."""
LARGEST_RADIUS = 200
"""As many cells as the largest map has on a side."""


class PheromoneConfig(Record):
    """Constants of the map; the paper leaves their values open."""

    decay: float = Field(default=0.1, ge=SLOWEST, le=1)
    """alpha: the share of the pheromone that is lost in a decision."""
    reinforcement: float = Field(default=0.1, ge=SLOWEST, le=1)
    """beta: what a visit adds to the occupancy of a cell in a decision."""
    initial: float = Field(default=0.0, ge=0, le=1)
    """rho_0: the occupancy of every free cell when an episode begins."""
    diffusion: float = Field(default=0.02, ge=0, le=FASTEST_DIFFUSION)
    """The share of the difference that flows between neighbouring cells in a decision."""
    radius: int = Field(default=2, ge=0, le=LARGEST_RADIUS)
    """Field of view: a robot reads the cells up to this many rows and columns away."""
    seen: Seen = "all"
    """What robots with stigmergy see: the cells around them and the tunnel density, or one of the two."""

    @property
    def saturation(self) -> float:
        """Occupancy of a cell that is visited without end, beta / alpha."""
        return self.reinforcement / self.decay


class SharedMemory(Protocol):
    """A pheromone map as robots use it: in the process that asks, or a service elsewhere."""

    @property
    def patch_size(self) -> int: ...

    def reset(self) -> None: ...

    def update(
        self, cell: Integers, mode: NDArray[np.uint8], laden: NDArray[np.bool_], action: Integers
    ) -> None: ...

    def read(self, cell: Integers, out: NDArray[np.float32], heading: Floats | None = None) -> None: ...

    def tunnel_density(self, cell: Integers) -> Floats: ...


class PheromoneMap:
    """Occupancy and the last visitors' marks for every cell, [envs, ...].

    Occupancy follows rho(t+1) = (1 - alpha) rho(t) + beta [visited] (the paper's section on digital
    pheromones) and then diffuses between free cells; walls reflect it.
    """

    def __init__(self, grid: Grid, num_envs: int, config: PheromoneConfig, num_actions: int) -> None:
        self._grid = grid
        self._config = config
        self._maps = np.zeros((num_envs, len(CHANNELS), grid.size))
        self._flat = self._maps.reshape(-1)
        # By flat index, to the cell above and to the one on the right; the last of a row has none.
        free, row = grid.free.ravel(), grid.shape[1]
        self._flow_up = config.diffusion * (free[row:] & free[:-row])
        self._flow_right = config.diffusion * (free[1:] & free[:-1])
        self._flow_right[row - 1 :: row] = 0.0
        side = np.arange(-config.radius, config.radius + 1)
        steps = np.array([(column, row) for row in side[::-1] for column in side], dtype=np.int64)
        self._patch = grid.flat_steps(steps)
        # Turned left by as many quarters as the heading is from east; ahead is where north is in the other.
        turned = [
            steps @ np.linalg.matrix_power(_QUARTER_LEFT, quarter - 1 + QUARTERS)
            for quarter in range(QUARTERS)
        ]
        self._turned_patches = np.stack([grid.flat_steps(one) for one in turned])
        self._first_cell = len(CHANNELS) * grid.size * np.arange(num_envs)[:, None]
        self._fade_scale = 1.0 / config.saturation
        self._action_marks = np.arange(1.0, num_actions + 1.0) * (1.0 / num_actions)

    @property
    def patch_size(self) -> int:
        """Numbers in a robot's field of view, all channels."""
        return len(CHANNELS) * len(self._patch)

    @property
    def values(self) -> Floats:
        """[envs, channels, cells] all that the map holds, by the grid's flat index; a copy."""
        return self._maps.copy()

    def restore(self, values: Floats) -> None:
        """Take over what `values` of a map of the same shape has returned; ValueError for another shape."""
        if np.shape(values) != self._maps.shape:
            raise ValueError(f"a map of shape {np.shape(values)} is not one of shape {self._maps.shape}")
        self._maps[...] = values

    def reset(self) -> None:
        """Return every environment's map to its initial state."""
        self._maps.fill(0.0)
        self._maps[:, 0] = self._config.initial * self._grid.free.ravel()

    @property
    def occupancy(self) -> Floats:
        """[envs, rows, columns] occupancy of the arena's cells, row 0 at the bottom."""
        margin = self._grid.margin
        padded = self._maps[:, 0].reshape(-1, *self._grid.shape)
        return padded[:, margin:-margin, margin:-margin]

    def tunnel_density(self, cell: Integers) -> Floats:
        """Return robots in the tunnel per cell of its length, for cells [envs, robots]; [envs]."""
        return self._grid.tunnel_density(cell)

    def update(
        self, cell: Integers, mode: NDArray[np.uint8], laden: NDArray[np.bool_], action: Integers
    ) -> None:
        """Advance one decision: decay, the marks of the robots in `cell`, diffusion.

        All arguments are [envs, robots]; `cell` is the flat index. Of several robots in one cell the
        last one leaves its marks, and the visit counts once.
        """
        occupancy = self._maps[:, 0]
        occupancy *= 1.0 - self._config.decay
        self.mark(cell, mode, laden, action)
        if self._config.diffusion > 0.0:
            self._diffuse(occupancy)

    def mark(
        self, cell: Integers, mode: NDArray[np.uint8], laden: NDArray[np.bool_], action: Integers
    ) -> None:
        """Leave the marks of robots without advancing; arguments as in `update`."""
        flat, size = self._flat, self._grid.size
        here = cell + self._first_cell
        flat[here] = flat.take(here) + self._config.reinforcement
        for mark in (_MODE_MARKS.take(mode), laden, self._action_marks.take(action)):
            here += size
            flat[here] = mark

    def _diffuse(self, rho: Floats) -> None:
        row = self._grid.shape[1]
        up = rho[:, row:] - rho[:, :-row]
        up *= self._flow_up
        right = rho[:, 1:] - rho[:, :-1]
        right *= self._flow_right
        rho[:, :-row] += up
        rho[:, row:] -= up
        rho[:, :-1] += right
        rho[:, 1:] -= right

    def read(self, cell: Integers, out: NDArray[np.float32], heading: Floats | None = None) -> None:
        """Write the patches around the robots in `cell` [envs, robots] into `out` [envs, robots, patch_size].

        Channel by channel, each from the north-west to the south-east; with a `heading` [envs, robots] (rad)
        from ahead on the left to behind on the right, to the nearest quarter of a turn. Occupancy is given
        relative to its saturation, at most 1; the marks fade with it. What lies outside reads 0.
        """
        at = (cell + self._first_cell)[..., None]
        if heading is None:
            at = at + self._patch
        else:
            quarter = np.rint(heading * (2.0 / np.pi)).astype(np.int64) % QUARTERS
            at = at + self._turned_patches.take(quarter, axis=0)
        strength = np.minimum(self._flat.take(at) * self._fade_scale, 1.0)
        size = len(self._patch)
        out[..., :size] = strength
        for channel in range(1, len(CHANNELS)):
            at += self._grid.size
            part = out[..., channel * size : (channel + 1) * size]
            np.multiply(self._flat.take(at), strength, out=part, casting="same_kind")
