"""The map of the service is that of training, however its parts are spread, and comes back from its file."""

import threading
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from robosim.control.policy import load_policy
from robosim.deploy.controller import Controller
from robosim.deploy.link.messages import NORTH_UP, Deposit
from robosim.deploy.processes.remote_map import RemoteMap
from robosim.deploy.processes.shared_map import SharedMap
from robosim.deploy.readings import of_one_robot
from robosim.deploy.simulated import SimulatedRobots
from robosim.discretise.cells import Grid
from robosim.discretise.pheromone import PheromoneMap
from robosim.envs.config import env_config
from robosim.errors import InputError

CONFIG, ARENA = env_config("paper", robots=3, pheromone_diffusion=0.05)


def deposit(decision, column, row, *, marks=True, mode=1, laden=True, action=2, facing=NORTH_UP):
    return Deposit(decision, column, row, facing, marks, mode, laden, action)


class AsOneProcess:
    """Robots that each have a controller of their own, around one map, with nothing but it in common."""

    def __init__(self, policy, world):
        self.map = SharedMap(world.config, world.arena, 1)
        self.robots = range(world.config.robots)
        self._together = threading.Barrier(len(self.robots))
        self._readings = {}
        self._memories = [
            RemoteMap(world.arena, world.config.pheromone, robot, self._exchange) for robot in self.robots
        ]
        self._controllers = [
            Controller(policy, len(self.robots), world.arena, memory=memory) for memory in self._memories
        ]

    def _exchange(self, deposit):
        robot = threading.current_thread().robot
        assert self.map.deposit(robot, deposit) == ""
        if self._together.wait() == 0:
            self._readings.update(self.map.tick(deposit.decision))
        self._together.wait()
        return self._readings[robot]

    def step(self, readings, period, now):
        commands = {}

        def drive(robot):
            threading.current_thread().robot = robot
            place = readings.pellet[robot]
            own = of_one_robot(
                robot,
                readings.time,
                readings.pose,
                laden=bool(readings.laden[robot]),
                at_pellet=bool(readings.at_pellet[robot]),
                touched=tuple(readings.touched[:, robot].tolist()),
                pellet=tuple(place) if np.isfinite(place).all() else None,
            )
            self._memories[robot].decision = period // 3
            commands[robot] = self._controllers[robot].step(own, now, period)

        threads = [threading.Thread(target=drive, args=(robot,)) for robot in self.robots]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        speeds = np.stack([commands[robot].wheel_speeds[robot] for robot in self.robots])
        gripper = np.stack([commands[robot].gripper[robot] for robot in self.robots])
        return replace(commands[0], wheel_speeds=speeds, gripper=gripper)


@pytest.mark.parametrize(("name", "robots"), [("paper-2-smadrl", 2), ("paper-4-wheels", 4)])
def test_robots_around_one_map_drive_as_one_controller_does_to_the_bit(name, robots):
    policy = load_policy(name)
    together = Controller(policy, robots)
    config = together.config.changed(pellet_gradient=0.0, profile=None)
    one, other = SimulatedRobots(config, 3), SimulatedRobots(config, 3)
    apart = AsOneProcess(policy, other)
    for period in range(36):
        one.obey(together.step(one.readings(), one.now))
        other.obey(apart.step(other.readings(), period, other.now))
        assert_array_equal(one.world.state.pose, other.world.state.pose)
    assert apart.map.occupancy.max() > 0.1


def reference(*visits):
    """A map of training after ticks, each of [(column, row)] visits."""
    grid = Grid(ARENA, margin=max(CONFIG.pheromone.radius, 1))
    plain = PheromoneMap(grid, 1, CONFIG.pheromone, 5)
    plain.reset()
    for cells in visits:
        places = (np.array(cells, float).reshape(-1, 2) + 0.5) * ARENA.cell_size
        flat = grid.flat_index(grid.cell_coordinates(places))[None]
        count = flat.shape[1]
        plain.update(flat, np.full((1, count), 1), np.ones((1, count), bool), np.full((1, count), 2))
    return plain


def test_ticks_that_were_missed_decay_and_late_marks_are_left_as_they_come():
    shared = SharedMap(CONFIG, ARENA, 1)
    shared.deposit(0, deposit(4, 3, 5, marks=False))
    assert list(shared.tick(4)) == [0]
    shared.deposit(0, deposit(5, 3, 5))
    shared.deposit(2, deposit(5, 9, 5))
    assert shared.has_all([0, 2], 5)
    assert not shared.has_all([0, 1, 2], 5)
    shared.tick(5)
    shared.deposit(0, deposit(9, 4, 5))
    shared.tick(9)
    assert_array_equal(
        shared.occupancy,
        np.float32(reference([(3, 5), (9, 5)], [], [], [], [(4, 5)]).occupancy[0]),
    )
    before = shared.occupancy
    assert shared.late(deposit(9, 6, 5))
    assert shared.deposit(1, deposit(9, 6, 5)) == ""
    gained = shared.occupancy - before
    assert gained[5, 6] == pytest.approx(CONFIG.pheromone.reinforcement)
    assert np.count_nonzero(gained) == 1
    # It is not waited for, nor answered again.
    assert shared.next_decision == -1


def test_the_density_counts_robots_whose_processes_are_there():
    shared = SharedMap(CONFIG, ARENA, 1)
    rows, columns = np.nonzero(ARENA.zones == 4)
    for robot in range(3):
        shared.deposit(robot, deposit(0, int(columns[robot]), int(rows[robot]), marks=False))
    assert shared.tick(0)[0].density == pytest.approx(3 / ARENA.tunnel_length)
    shared.forget(1)
    assert shared.read(0, deposit(0, 0, 0)).density == pytest.approx(2 / ARENA.tunnel_length)


def test_deposits_that_make_no_sense_are_dropped():
    shared = SharedMap(CONFIG, ARENA, 1)
    assert shared.deposit(0, deposit(1, 3, 5, action=5)) == "unknown action"
    assert shared.deposit(0, deposit(1, 60000, 5)) == "off the map"
    assert shared.deposit(0, deposit(2, 3, 5)) == ""
    assert shared.deposit(0, deposit(1, 3, 5)) == "of a decision that is past"


def worked(ticks):
    shared = SharedMap(CONFIG, ARENA, 1)
    for tick in range(ticks):
        shared.deposit(0, deposit(tick, 3 + tick % 4, 5, marks=tick > 0))
        shared.tick(tick)
    return shared


def test_a_map_comes_back_from_its_file_and_goes_on_as_if_nothing_had_been(tmp_path):
    path = tmp_path / "map.npz"
    shared, again = worked(20), SharedMap(CONFIG, ARENA, 1)
    shared.save(path, world=77)
    assert again.restore(path) == 77
    assert again.decision == 19
    for one in (shared, again):
        one.deposit(1, deposit(22, 9, 6))
        one.tick(22)
    assert_array_equal(shared.occupancy, again.occupancy)
    assert_array_equal(shared.read(1, deposit(22, 9, 6)).patch, again.read(1, deposit(22, 9, 6)).patch)
    assert [file.name for file in tmp_path.iterdir()] == ["map.npz"]


def test_a_file_that_is_no_map_of_this_team_is_refused_and_left_alone(tmp_path):
    path = tmp_path / "map.npz"
    shared = SharedMap(CONFIG, ARENA, 1)
    for data in (b"", b"text", b"PK\x03\x04" + bytes(50)):
        path.write_bytes(data)
        with pytest.raises(
            InputError, match=r"map\.npz: not a saved pheromone map; give another file, or remove"
        ):
            shared.restore(path)
    np.savez(path, format=np.array([{"code": "runs"}], object))
    with pytest.raises(InputError, match="not a saved pheromone map"):
        shared.restore(path)
    worked(3).save(path, world=1)
    with pytest.raises(
        InputError, match=r"map\.npz: of another arena, team or pheromones; give another file"
    ):
        SharedMap(CONFIG, ARENA, 2).restore(path)
    values = np.zeros((1, 4, 3))
    np.savez(
        path,
        format=np.array("robosim pheromone map, version 1"),
        setup=np.array([1], np.uint64),
        world=np.array([1], np.uint64),
        decision=np.array([3]),
        values=values,
    )
    with pytest.raises(
        InputError, match=r"map\.npz: not a whole map; remove the file to begin with an empty one"
    ):
        shared.restore(path)
