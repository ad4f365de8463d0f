"""The paper's own abstraction: one robot a cell, a decision as long as a cell at top speed."""

from robosim.world.grid.world import GridWorld

__all__ = ["GridWorld"]
