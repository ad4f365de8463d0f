"""A second physics, in MuJoCo, as stand-in for reality; the only place that knows of MuJoCo."""

from robosim.deploy.mujoco.world import MujocoWorld

__all__ = ["MujocoWorld"]
