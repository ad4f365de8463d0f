"""Frames kept as columns until they are used: one array a field, one row a decision."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robosim.episodes.frame import Frame

ROWS = 4000
"""Decisions kept before they are handed on; bounds the memory of a recording."""

PHEROMONE_STEPS = 10
"""Decisions between two pictures of the pheromone map."""


class FrameColumns:
    """The last frames of a run, at most `size`, copied into arrays; the first `rows` of each are valid.

    Contacts are flat: row i holds `contact_count[i]` of them, one after another.
    """

    def __init__(self, robots: int, pellets: int, cells: tuple[int, int], size: int = ROWS) -> None:
        self.rows = 0
        self.size = size
        pictures = -(-size // PHEROMONE_STEPS)
        self.step = np.empty(size, dtype=np.int64)
        self.time = np.empty(size)
        self.pose = np.empty((size, robots, 3))
        self.mode = np.empty((size, robots), dtype=np.uint8)
        self.action = np.empty((size, robots), dtype=np.uint8)
        self.laden = np.empty((size, robots), dtype=np.bool_)
        self.reward = np.empty((size, robots), dtype=np.float32)
        self.pellets = np.empty((size, pellets, 2))
        self.pellet_status = np.empty((size, pellets), dtype=np.uint8)
        self.delivered = np.empty((size, robots), dtype=np.int64)
        self.energy = np.empty((size, robots))
        self.closest = np.empty((size, robots))
        self.density = np.empty(size)
        self.pictures = 0
        self.picture_row = np.empty(pictures, dtype=np.int64)
        self.pheromone = np.empty((pictures, *cells), dtype=np.float32)
        self.contacts = 0
        self.contact_count = np.empty(size, dtype=np.int64)
        self._allocate_contacts(4 * size)

    def add(self, frame: Frame) -> bool:
        """Copy a frame; return whether the columns are full and must be written before the next."""
        row = self.rows
        self.step[row] = frame.step
        self.time[row] = frame.time
        self.pose[row] = frame.pose
        self.mode[row] = frame.mode
        self.action[row] = frame.action
        self.laden[row] = frame.laden
        self.reward[row] = frame.reward
        self.pellets[row] = frame.pellets
        self.pellet_status[row] = frame.pellet_status
        self.delivered[row] = frame.delivered
        self.energy[row] = frame.energy
        self.closest[row] = frame.closest
        self.density[row] = frame.density
        if row % PHEROMONE_STEPS == 0:
            self.picture_row[self.pictures] = row
            self.pheromone[self.pictures] = frame.pheromone
            self.pictures += 1
        self._add_contacts(frame)
        self.rows = row + 1
        return self.rows == self.size

    @property
    def nbytes(self) -> int:
        """Size of all arrays."""
        return sum(array.nbytes for array in vars(self).values() if isinstance(array, np.ndarray))

    def row_of_contact(self) -> NDArray[np.intp]:
        """Return the row of each contact, [contacts]."""
        return np.repeat(np.arange(self.rows), self.contact_count[: self.rows])

    def clear(self) -> None:
        """Forget the frames, keep the memory."""
        self.rows = self.pictures = self.contacts = 0

    def _add_contacts(self, frame: Frame) -> None:
        contacts = frame.contacts
        count = len(contacts.impulse)
        self.contact_count[self.rows] = count
        if count == 0:
            return
        first, end = self.contacts, self.contacts + count
        if end > len(self.contact_impulse):
            self._allocate_contacts(2 * end)
        self.contact_time[first:end] = contacts.time
        self.contact_kind[first:end] = contacts.kind
        self.contact_pair[first:end, 0] = contacts.a
        self.contact_pair[first:end, 1] = contacts.b
        self.contact_position[first:end] = contacts.position
        self.contact_impulse[first:end] = contacts.impulse
        self.contacts = end

    def _allocate_contacts(self, size: int) -> None:
        kept = self.contacts
        time, kind = np.empty(size), np.empty(size, dtype=np.uint8)
        pair = np.empty((size, 2), dtype=np.int64)
        position, impulse = np.empty((size, 2)), np.empty(size)
        if kept:
            time[:kept] = self.contact_time[:kept]
            kind[:kept] = self.contact_kind[:kept]
            pair[:kept] = self.contact_pair[:kept]
            position[:kept] = self.contact_position[:kept]
            impulse[:kept] = self.contact_impulse[:kept]
        self.contact_time: NDArray[np.float64] = time
        self.contact_kind: NDArray[np.uint8] = kind
        self.contact_pair: NDArray[np.int64] = pair
        self.contact_position: NDArray[np.float64] = position
        self.contact_impulse: NDArray[np.float64] = impulse
