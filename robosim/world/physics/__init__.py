"""The physical world in pymunk; the only place that knows of it."""

from robosim.world.physics.world import PhysicsWorld

__all__ = ["PhysicsWorld"]
