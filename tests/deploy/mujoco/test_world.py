"""Bodies in MuJoCo under the rules of the physical world: nothing is lost, nobody falls over or through."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

pytest.importorskip("mujoco")

from robosim.arena import load_arena
from robosim.control.policy import load_policy
from robosim.deploy import Controller
from robosim.deploy.mujoco import MujocoWorld
from robosim.deploy.mujoco.model import LIFT, pellet_centre
from robosim.deploy.mujoco.validation import MIDDLE, begun, driven, last
from robosim.deploy.simulated import make_stand_in
from robosim.errors import InputError
from robosim.robot.drivers import STOP, Wheels
from robosim.world.contacts import ContactKind
from robosim.world.physics import PhysicsWorld
from robosim.world.state import ABSENT, HELD, LOOSE, Gripper

REACH = 0.5 * 0.11 + 0.02 + 0.04
"""From a robot's middle to the farthest pellet that it may take, m."""


def decide(world, actions, gripper=Gripper.KEEP):
    world.step(np.array([actions]), np.full((1, world.robots), gripper, dtype=np.int8))


def heights(world):
    """Of the middles of robots and pellets above the ground, m."""
    space = world.spaces[0]
    return space.data.qpos[space._place[:, 2]]


@pytest.fixture(scope="module")
def at_work():
    """A team of four, yielded after each of 100 decisions."""
    controller = Controller(load_policy("paper-4"), name="paper-4")
    robots = make_stand_in("mujoco", controller.config, seed=3)
    states = []
    for _ in range(100):
        for _ in range(robots.arena.timing.control_steps):
            robots.obey(controller.step(robots.readings(), robots.now))
        state, space = robots.world.state, robots.world.spaces[0]
        turned = space.data.qpos[space._place[: robots.world.robots, 3:]]
        upright = 1.0 - 2.0 * (turned[:, 1] ** 2 + turned[:, 2] ** 2)
        states.append(
            {
                "pose": state.pose[0].copy(),
                "pellets": state.pellets[0].copy(),
                "status": state.pellet_status[0].copy(),
                "held": state.held[0].copy(),
                "delivered": int(state.delivered[0]),
                "refilled": int(state.refilled[0]),
                "heights": heights(robots.world).copy(),
                "tilt": np.arccos(np.minimum(upright, 1.0)),
            }
        )
    return robots.arena, states


def test_a_trained_team_works_in_a_physics_that_it_has_never_seen(at_work) -> None:
    _, states = at_work
    assert states[-1]["delivered"] >= 2


def test_pellets_are_conserved(at_work) -> None:
    arena, states = at_work
    for state in states:
        status, held = state["status"], state["held"]
        assert len(status) == arena.pellets.count
        assert state["delivered"] == state["refilled"] + (status == ABSENT).sum()
        assert_array_equal(np.flatnonzero(status == HELD), np.sort(held[held >= 0]))


def test_robots_stay_upright_and_everything_stays_on_the_ground(at_work) -> None:
    arena, states = at_work
    robots = len(states[0]["pose"])
    for state in states:
        assert_allclose(state["heights"][:robots], arena.robot.wheel_radius, atol=1e-3)
        assert state["tilt"].max() < np.radians(3.0)
        loose = state["status"] == LOOSE
        assert_allclose(state["heights"][robots:][loose], pellet_centre(arena), atol=1.5 * LIFT)


def test_nobody_is_in_a_wall_or_in_another(at_work) -> None:
    arena, states = at_work
    radius, walls = 0.5 * arena.robot.length, arena.walls
    for state in states:
        place = state["pose"][:, None, :2]
        nearest = np.clip(place, walls[:, :2], walls[:, 2:])
        assert np.hypot(*np.moveaxis(place - nearest, -1, 0)).min() > radius - 1e-3
        apart = np.hypot(*np.moveaxis(place - state["pose"][None, :, :2], -1, 0))
        assert apart[~np.eye(len(apart), dtype=bool)].min() > 2 * radius - 1e-3


def test_a_seed_begins_the_same_episode_in_both_engines() -> None:
    arena = load_arena("paper")
    worlds = [world(arena, 3, 1, "cardinal", 2.0) for world in (PhysicsWorld, MujocoWorld)]
    for world in worlds:
        world.reset([np.random.SeedSequence(7)])
    for field in ("pose", "pellets", "pellet_status", "nearest", "touching"):
        assert_array_equal(getattr(worlds[0].state, field), getattr(worlds[1].state, field))
    assert_allclose(worlds[1].spaces[0].poses()[:3], worlds[0].state.pose[0], atol=1e-12)


def test_the_same_commands_give_the_same_bits() -> None:
    ends = []
    for _ in range(2):
        world = MujocoWorld(load_arena("paper"), 3, 1, "wheels")
        world.reset([np.random.SeedSequence(7)])
        for turn in range(5):
            decide(world, [turn % 5, 0, 2], Gripper.TAKE)
        ends.append((world.state.pose.copy(), world.state.pellets.copy(), world.contacts.impulse))
    for one, other in zip(*ends, strict=True):
        assert_array_equal(one, other)


@pytest.mark.parametrize("engine", [PhysicsWorld, MujocoWorld])
@pytest.mark.parametrize(("apart", "taken"), [(REACH - 1e-3, True), (REACH + 1e-3, False)])
def test_a_gripper_takes_what_is_within_its_reach(engine, apart, taken) -> None:
    world = begun(engine, (*MIDDLE, 0.0))
    world.spaces[0].place(0, np.array([MIDDLE[0] + apart, MIDDLE[1]]))
    decide(world, [STOP])
    assert (world.state.touching[0, 0] == 0) == taken
    decide(world, [STOP], Gripper.TAKE)
    assert (world.state.held[0, 0] == 0) == taken


def test_a_held_pellet_is_lifted_carried_and_dropped() -> None:
    world = begun(MujocoWorld, (*MIDDLE, 0.0))
    world.spaces[0].place(0, np.array([MIDDLE[0] + 0.09, MIDDLE[1] + 0.02]))
    decide(world, [STOP])
    decide(world, [STOP], Gripper.TAKE)
    ground = pellet_centre(world.arena)
    for action in (Wheels.FORWARD, Wheels.SPIN_LEFT, Wheels.BACK, Wheels.STOP):
        decide(world, [int(action)])
        x, y, heading = world.state.pose[0, 0]
        cos, sin = np.cos(heading), np.sin(heading)
        held = (x + 0.09 * cos - 0.02 * sin, y + 0.09 * sin + 0.02 * cos)
        assert_allclose(world.state.pellets[0, 0], held, atol=2e-3)
        # The robot leans forward under its weight.
        assert ground + 2e-4 < heights(world)[1] < ground + 2 * LIFT
    decide(world, [STOP], Gripper.OPEN)
    place = world.state.pellets[0, 0].copy()
    last(driven(world, -5.0, -5.0, 6))
    decide(world, [STOP])
    assert_allclose(world.state.pellets[0, 0], place, atol=1e-3)
    assert heights(world)[1] == pytest.approx(ground, abs=5e-4)


def test_a_pellet_let_go_at_home_is_delivered_and_comes_back_in_the_source() -> None:
    world = begun(MujocoWorld, (0.5, 1.9, 0.0))
    world.spaces[0].place(0, np.array([0.4 + 0.16, 2.1]))
    decide(world, [STOP])
    state, source = world.state, world.arena.pellet_places
    assert state.delivered[0] == 1
    assert state.refilled[0] == 1
    assert np.hypot(*(source - state.pellets[0, 0]).T).min() < 1e-9
    decide(world, [STOP])
    assert np.hypot(*(source - state.pellets[0, 0]).T).min() < 1e-3


def test_who_touches_what() -> None:
    x, y = MIDDLE
    world = begun(MujocoWorld, (x, y, 0.0), (x + 0.13, y, np.pi), (4.1, y, 0.0), (x, 0.7, 0.0))
    world.spaces[0].place(0, np.array([x + 0.08, 0.7]))
    decide(world, [int(Wheels.FORWARD)] * 3 + [STOP])
    decide(world, [int(Wheels.FORWARD)] * 4)
    assert_array_equal(world.state.touched[ContactKind.ROBOT_ROBOT, 0], [True, True, False, False])
    assert_array_equal(world.state.touched[ContactKind.ROBOT_WALL, 0], [False, False, True, False])
    assert_array_equal(world.state.touched[ContactKind.ROBOT_PELLET, 0], [False, False, False, True])
    contacts = world.contacts
    meeting = contacts.kind == ContactKind.ROBOT_ROBOT
    assert_array_equal(np.unique(np.stack([contacts.a, contacts.b])[:, meeting], axis=1), [[0], [1]])
    assert_allclose(contacts.position[meeting], [[x + 0.065, y]] * meeting.sum(), atol=5e-3)


def test_another_robots_pellet_is_a_part_of_it() -> None:
    x, y = MIDDLE
    world = begun(MujocoWorld, (x, y, 0.0), (x + 0.3, y, np.pi))
    world.spaces[0].place(0, np.array([x + 0.08, y]))
    decide(world, [STOP, STOP])
    world.step(np.array([[STOP, STOP]]), np.array([[Gripper.TAKE, Gripper.KEEP]], dtype=np.int8))
    assert_array_equal(world.state.held[0], [0, -1])
    decide(world, [STOP, int(Wheels.FORWARD)])
    decide(world, [STOP, int(Wheels.FORWARD)])
    decide(world, [STOP, int(Wheels.FORWARD)])
    assert world.state.touched[ContactKind.ROBOT_ROBOT, 0].all()
    assert not world.state.touched[ContactKind.ROBOT_PELLET, 0].any()


def test_pellets_that_hold_together_are_refused() -> None:
    with pytest.raises(InputError) as caught:
        MujocoWorld(load_arena("three-wide"), 1, 1, "cardinal")
    assert str(caught.value) == (
        "pellets.cohesion is 0.05, but must be 0 in MuJoCo, which has no pull between pellets."
    )


def test_a_solver_that_explodes_is_an_error_and_no_outcome(tmp_path, monkeypatch) -> None:
    # MuJoCo logs its warning where it runs.
    monkeypatch.chdir(tmp_path)
    world = begun(MujocoWorld, (*MIDDLE, 0.0))
    world.spaces[0].data.qvel[0] = 1e12
    with pytest.raises(RuntimeError, match="MuJoCo has become unstable"):
        decide(world, [STOP])


def test_energy_is_not_metered_but_distances_are() -> None:
    x, y = MIDDLE
    world = begun(MujocoWorld, (x, y, 0.0), (x + 0.5, y, 0.0))
    world.meter()
    assert world.closest.tolist() == [[pytest.approx(0.5)] * 2]
    world.step(np.array([[int(Wheels.FORWARD), STOP]]), np.zeros((1, 2), dtype=np.int8))
    assert (world.wheel_energy == 0.0).all()
    assert 0.4 < world.closest.min() < 0.48
