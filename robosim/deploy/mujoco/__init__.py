"""A second physics in MuJoCo, in three dimensions, as stand-in for reality; the only place that knows of it."""

from robosim.deploy.mujoco.world import MujocoWorld

__all__ = ["MujocoWorld"]
