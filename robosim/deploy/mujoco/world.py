"""The physical world with its bodies in MuJoCo: the same rules and draws, other physics."""

from __future__ import annotations

from robosim.arena.model import Arena
from robosim.deploy.mujoco.space import Floats, MujocoSpace
from robosim.errors import refused
from robosim.robot.drivers import ActionKind
from robosim.world.draws import Draws
from robosim.world.motion import EXACT, MotionConfig
from robosim.world.physics.world import PhysicsWorld


class MujocoWorld(PhysicsWorld):
    """Robots on two driven wheels in three dimensions, in place of discs that are pushed by force.

    Who may take which pellet, what is delivered and where fresh pellets lie are the rules of `PhysicsWorld`,
    the same code, and a seed draws the same starts, pellets, motors and delays. How bodies move is MuJoCo's.
    """

    ramps = True

    def __init__(
        self,
        arena: Arena,
        robots: int,
        num_envs: int,
        actions: ActionKind,
        pellet_gradient: float = 0.0,
        motion: MotionConfig = EXACT,
        keep_distance: float | None = None,
    ) -> None:
        if arena.pellets.cohesion > 0.0:
            raise refused(
                "pellets.cohesion", arena.pellets.cohesion, "0 in MuJoCo, which has no pull between pellets"
            )
        if arena.groups:
            names = [group.name for group in arena.groups]
            raise refused("groups", names, "left out in MuJoCo, whose robots are all alike")
        super().__init__(arena, robots, num_envs, actions, pellet_gradient, motion, keep_distance)

    def _meter_wheels(self, pose: Floats, velocity: Floats) -> None:
        """Energy stays 0: slip is worked out from how pymunk drives."""

    def _new_bodies(self, draws: Draws, commands: Floats) -> MujocoSpace:
        return MujocoSpace(self.arena, draws, commands)

    def _command(self, heading: Floats, half: Floats) -> None:
        """Command wheel speeds, not the velocities that they should give the body."""
        self._commands[..., :2] = self.wheel_speeds
