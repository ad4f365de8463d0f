"""The controller drives as the simulator does, and stops robots where it must."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from robosim.arena import Zone
from robosim.control.environment import environment_for
from robosim.control.learned import LearnedController
from robosim.control.policy import find_policy, load_policy
from robosim.deploy import Controller
from robosim.deploy.export import onnx_model
from robosim.deploy.readings import Readings, of_one_robot
from robosim.deploy.runtime import OnnxPolicy
from robosim.deploy.simulated import SimulatedRobots
from robosim.errors import InputError
from robosim.world.state import Gripper
from tests.deploy.made import make_policy

MADE = {
    "the paper's numbers": {"env": {"encoding": "paper"}},
    "nine wheel commands": {"env": {"actions": "wheels-9"}, "mask": True},
    "keeps its distance": {"env": {"keep_distance": 0.25}},
    "no pheromones": {"env": {"stigmergy": False, "neighbours": False}},
    "learned on the grid": {"env": {"world": "grid"}},
    "draws its actions": {"output": "logits", "temperature": 0.5, "mask": True},
    "the whole team's numbers": {"input": "team", "output": "joint action values"},
}


def beside_evaluation(policy, decisions, seed=5):
    """Drive one world as evaluation does, and another by a controller's wheel speeds; yield both."""
    chooser = LearnedController(policy, "policy")
    env = environment_for(chooser, world="physics", seed=seed)
    observation = env.reset()
    chooser.reset(env)
    controller = Controller(policy)
    robots = SimulatedRobots(env.config, env.seeds[0])
    for _ in range(decisions):
        actions = chooser.act(env, observation)
        for period in range(env.arena.timing.control_steps):
            command = controller.step(robots.readings(), robots.now)
            if period == 0:
                assert_array_equal(command.actions, actions[0])
                assert_array_equal(command.gripper, env.dec_pomdp.gripper_commands()[0])
            else:
                assert command.actions is None
            robots.obey(command)
        observation = env.step(actions).observation
        yield env, robots, controller


def assert_same_world(env, other):
    for field in ("pose", "velocity", "pellets", "pellet_status", "held", "touched", "delivered"):
        assert_array_equal(getattr(env.world.state, field), getattr(other.world.state, field), err_msg=field)


@pytest.mark.parametrize("name", ["paper-8", "paper-4-smadrl", "paper-4-wheels"])
def test_wheel_speeds_alone_give_the_trajectory_of_an_evaluation_to_the_bit(name):
    laden = 0
    for env, robots, controller in beside_evaluation(load_policy(name), 90):
        assert_same_world(env, robots)
        assert controller.decisions == env.steps_taken
        laden = max(laden, int((env.world.state.held >= 0).sum()))
    assert laden > 1


@pytest.mark.parametrize("made", MADE)
def test_so_do_those_of_made_up_policies(tmp_path, made):
    fields = {"of_robot": (0, 0, 0), **MADE[made]}
    policy = load_policy(make_policy(tmp_path / "made", **fields))
    for env, robots, _ in beside_evaluation(policy, 60):
        assert_same_world(env, robots)


def test_robots_that_have_come_to_a_stand_retreat_on_the_floor_as_in_simulation(tmp_path):
    # Each repeats one action, so it soon stands at a wall.
    fields = {"of_robot": (0, 0, 0), "output": "logits", "temperature": 0.001}
    poses = []
    for number, retreat in enumerate((None, 12)):
        policy = load_policy(make_policy(tmp_path / str(number), retreat_in_place=retreat, **fields))
        for env, robots, _ in beside_evaluation(policy, 60):
            assert_same_world(env, robots)
        poses.append(robots.world.state.pose)
    assert (poses[0] != poses[1]).any()


def started(name="paper-2", periods=0, **options):
    controller = Controller(load_policy(name), name=name, **options)
    robots = SimulatedRobots(controller.config.changed(pellet_gradient=0.0), seed=1)
    for _ in range(periods):
        robots.obey(controller.step(robots.readings(), robots.now))
    return controller, robots


def test_onnxruntime_may_choose_in_the_place_of_numpy():
    policy = OnnxPolicy(onnx_model(find_policy("paper-2")))
    by_onnx, (by_numpy, robots) = Controller(policy), started()
    for _ in range(60):
        readings = robots.readings()
        command, other = by_numpy.step(readings, robots.now), by_onnx.step(readings, robots.now)
        assert_array_equal(command.wheel_speeds, other.wheel_speeds)
        robots.obey(command)


def test_wheel_speeds_keep_to_the_data_sheet():
    controller, robots = started("paper-8")
    largest = 0.0
    for _ in range(300):
        command = controller.step(robots.readings(), robots.now)
        largest = max(largest, float(np.abs(command.wheel_speeds).max()))
        robots.obey(command)
    assert largest == controller.arena.robot.max_wheel_speed


def test_a_reset_begins_a_run_anew():
    controller, _ = started(periods=20)
    again, robots = started()
    controller.reset()
    for _ in range(20):
        readings = robots.readings()
        one, other = controller.step(readings, robots.now), again.step(readings, robots.now)
        assert_array_equal(one.wheel_speeds, other.wheel_speeds)
        robots.obey(one)


def test_readings_that_are_too_old_stop_a_robot_until_there_are_new_ones():
    controller, robots = started("paper-4", periods=30, max_age=0.35)
    lost = robots.readings()
    seen_last = robots.now
    for _ in range(12):
        fresh = robots.readings()
        times, poses = fresh.time.copy(), fresh.pose.copy()
        times[2], poses[2] = lost.time[2], lost.pose[2]
        command = controller.step(replace(fresh, time=times, pose=poses), robots.now)
        age = robots.now - seen_last
        assert command.stopped[:2] + command.stopped[3:] == ("", "", "")
        assert command.stopped[2] == (f"pose is {age:.2f} s old" if age > 0.35 else "")
        if age > 0.35:
            assert_array_equal(command.wheel_speeds[2], [0, 0])
            assert command.gripper[2] == Gripper.KEEP
            assert command.actions is None or command.actions[2] == 4
        robots.obey(command)
    assert np.abs(robots.world.state.velocity[0, 2]).max() < 1e-3
    assert np.abs(robots.world.state.velocity[0, [0, 1, 3]]).max() > 0.05
    for _ in range(3):
        command = controller.step(robots.readings(), robots.now)
        assert command.stopped == ("",) * 4
        robots.obey(command)
    assert np.abs(command.wheel_speeds[2]).max() > 0


@pytest.mark.parametrize(
    ("pose", "reason"),
    [
        ((np.nan, 0.5, 0.0), "no pose"),
        ((0.5, 0.5, np.inf), "no pose"),
        ((-0.01, 0.5, 0.0), "off the map at (-0.01, 0.5)"),
        ((0.5, 1e9, 0.0), "off the map at (0.5, 1e+09)"),
    ],
)
def test_a_robot_without_a_pose_on_the_map_stops_and_the_others_go_on(pose, reason):
    controller, robots = started("paper-2", periods=30)
    readings = robots.readings()
    readings.pose[1] = pose
    for _ in range(4):
        command = controller.step(readings, robots.now)
        assert command.stopped == ("", reason)
        assert_array_equal(command.wheel_speeds[1], [0, 0])
    assert np.abs(command.wheel_speeds[0]).max() > 0


def test_a_time_stamp_ahead_of_the_clock_is_no_better_than_an_old_one():
    controller, robots = started(periods=30)
    readings = robots.readings()
    readings.time[0] += 0.7
    readings.time[1] += 0.3
    command = controller.step(readings, robots.now)
    assert command.stopped == ("pose is 0.70 s ahead", "")


def test_a_heading_of_any_turn_is_the_same_heading():
    controller, robots = started(periods=30)
    turned, _ = started(periods=30)
    readings = robots.readings()
    further = readings.pose.copy()
    further[:, 2] += 4 * np.pi
    one = controller.step(readings, robots.now)
    other = turned.step(replace(readings, pose=further), robots.now)
    assert_array_equal(one.actions, other.actions)
    np.testing.assert_allclose(one.wheel_speeds, other.wheel_speeds, atol=1e-9)


def test_an_emergency_stop_holds_all_robots_and_sees_that_they_rest():
    controller, robots = started("paper-4", periods=31)
    assert np.abs(robots.world.state.velocity).max() > 0.05
    command = controller.emergency_stop("a hand in the arena")
    for _ in range(12):
        assert command.stopped == ("a hand in the arena",) * 4
        assert not command.wheel_speeds.any()
        assert not command.unstopped.any()
        robots.obey(command)
        command = controller.step(robots.readings(), robots.now)
    assert np.abs(robots.world.state.velocity).max() < 1e-3
    controller.resume()
    for _ in range(3):
        command = controller.step(robots.readings(), robots.now)
        robots.obey(command)
    assert command.stopped == ("",) * 4
    assert np.abs(command.wheel_speeds).max() > 0


def test_an_emergency_stop_that_comes_in_the_midst_of_a_decision_holds_at_once():
    """A robot hears what comes while its decision waits for the map."""
    policy = load_policy("paper-4")

    class Interrupted:
        card = policy.card

        def act(self, observation, decision=None):
            if decision == 3:
                controller.emergency_stop("a hand in the arena")
            return policy.act(observation, decision)

    controller = Controller(Interrupted())
    robots = SimulatedRobots(controller.config, 5)
    for period in range(5 * controller.arena.timing.control_steps):
        command = controller.step(robots.readings(), robots.now)
        held = period >= 3 * controller.arena.timing.control_steps
        assert command.stopped == ("a hand in the arena" if held else "",) * 4
        assert command.wheel_speeds.any() == (not held)
        if held:
            assert (command.gripper == Gripper.KEEP).all()
            assert command.actions is None or (command.actions == 4).all()
        robots.obey(command)


def test_an_emergency_stop_says_who_does_not_stop_or_is_not_seen():
    controller, robots = started("paper-4", periods=31)
    command = controller.emergency_stop()
    told = []
    for _ in range(12):
        deaf = command.wheel_speeds.copy()
        deaf[1] = [6.0, -6.0]
        robots.obey(replace(command, wheel_speeds=deaf))
        readings = robots.readings()
        readings.pose[3] = np.nan
        command = controller.step(readings, robots.now)
        told.append(command.unstopped.tolist())
    # Half a second to come to rest, and then a period or two to see who has not.
    assert told[0] == told[3] == [False] * 4
    assert told[-1] == [False, True, False, True]


def test_a_robot_with_a_computer_of_its_own_knows_its_own_sensors():
    readings = SimulatedRobots(load_policy("paper-2").card.env, seed=1).readings()
    alone = of_one_robot(
        1,
        readings.time,
        readings.pose,
        laden=True,
        at_pellet=False,
        touched=(False, True, False),
        pellet=(1.0, 0.5),
    )
    assert alone.laden.tolist() == [False, True]
    assert alone.at_pellet.tolist() == [False, False]
    assert alone.touched.tolist() == [[False, False], [False, True], [False, False]]
    assert_array_equal(alone.pellet, [[np.nan, np.nan], [1.0, 0.5]])
    assert_array_equal(alone.pose, readings.pose)
    # A team of one knows all there is to know.
    one, robots = started("paper-1")
    other, _ = started("paper-1")
    for _ in range(90):
        full = robots.readings()
        seen = None if np.isnan(full.pellet[0]).any() else tuple(full.pellet[0])
        own = of_one_robot(
            0,
            full.time,
            full.pose,
            laden=bool(full.laden[0]),
            at_pellet=bool(full.at_pellet[0]),
            touched=tuple(full.touched[:, 0]),
            pellet=seen,
        )
        command = one.step(full, robots.now)
        assert_array_equal(command.wheel_speeds, other.step(own, robots.now).wheel_speeds)
        robots.obey(command)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"time": np.zeros(3)}, "readings: time has the shape [3], but must be [2]."),
        ({"touched": np.zeros((2, 2), bool)}, "readings: touched has the shape [2, 2], but must be [3, 2]."),
        (
            {"pose": np.array([[0.5, 0.5, 0], [9, 0.5, 0]])},
            "readings: pose of robot 1 is (9, 0.5), but must be on the map of 3.9 x 1.2 m as a run begins.",
        ),
    ],
)
def test_readings_that_cannot_be_used_are_refused_in_a_sentence(change, sentence):
    controller, robots = started()
    with pytest.raises(InputError) as caught:
        controller.step(replace(robots.readings(), **change), 0.0)
    assert str(caught.value) == sentence


@pytest.mark.parametrize(
    ("name", "options", "sentence"),
    [
        (
            "paper-2-smadrl",
            {"robots": 3},
            "policy x does not fit arena 'paper': robots was 2 in training and is 3 here.",
        ),
        ("paper-2", {"max_age": 0.0}, "max_age is 0.0, but must be a number of seconds above 0."),
        ("paper-2", {"max_age": float("nan")}, "max_age is nan, but must be a number of seconds above 0."),
    ],
)
def test_what_does_not_fit_a_policy_is_refused_in_a_sentence(name, options, sentence):
    with pytest.raises(InputError) as caught:
        Controller(load_policy(name), name="x", **options)
    assert str(caught.value) == sentence


def test_a_robots_computer_needs_neither_simulator_nor_learner(tmp_path):
    controller, robots = started("paper-4")
    columns = {name: [] for name in Readings.__dataclass_fields__}
    expected = []
    for _ in range(30):
        readings = robots.readings()
        for name, column in columns.items():
            column.append(getattr(readings, name))
        command = controller.step(readings, robots.now)
        expected.append(command.wheel_speeds)
        robots.obey(command)
    np.savez(tmp_path / "readings.npz", **columns)
    code = f"""
import sys
import numpy as np
import robosim
from robosim.deploy import Controller, DecisionLog, Readings
controller = Controller(robosim.load_policy("paper-4"), log=DecisionLog({str(tmp_path / "log.jsonl")!r}))
columns = dict(np.load({str(tmp_path / "readings.npz")!r}))
speeds = []
for row in range(30):
    readings = Readings(**{{name: column[row] for name, column in columns.items()}})
    speeds.append(controller.step(readings, readings.time[0]).wheel_speeds)
np.save({str(tmp_path / "speeds.npy")!r}, speeds)
print(*sorted({{name.partition(".")[0] for name in sys.modules}}))
"""
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    heavy = "pymunk torch gymnasium pettingzoo scipy onnx onnxruntime rerun matplotlib pyarrow rich tyro"
    assert set(ran.stdout.split()) & set(heavy.split()) == set()
    assert "numpy" in ran.stdout.split()
    assert_array_equal(np.load(tmp_path / "speeds.npy"), expected)


def test_a_robot_that_is_seen_in_a_wall_drives_out_of_it():
    """A tracker is a few millimetres off, and a robot along a wall is then seen within it."""
    controller = Controller(load_policy("paper-2"))
    size = controller.arena.cell_size
    tunnel = np.argwhere(controller.arena.zones == Zone.TUNNEL)
    top = tunnel[:, 0].max() + 1
    in_wall = np.array([1.9, top * size + 0.005, np.pi])
    assert controller.arena.zones[top, int(1.9 / size)] == Zone.WALL
    moved = 0
    for period in range(12):
        now = 0.1 * period
        readings = Readings(
            time=np.full(2, now),
            pose=np.stack([in_wall, [1.0, 0.675, 0.0]]),
            laden=np.zeros(2, bool),
            at_pellet=np.zeros(2, bool),
            touched=np.zeros((3, 2), bool),
            pellet=np.full((2, 2), np.nan),
        )
        command = controller.step(readings, now)
        assert command.stopped == ("", "")
        moved += bool(command.wheel_speeds[0].any())
    assert moved > 6
