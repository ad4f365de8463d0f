import numpy as np
import pytest
from numpy.testing import assert_array_equal

from robosim.arena.model import Zone
from robosim.control.controller import make_controller
from robosim.discretise.modes import Mode
from robosim.envs.vector import VectorEnv


def test_after_reset_nothing_has_happened() -> None:
    env = VectorEnv("paper", robots=3, num_envs=2)
    env.reset(4)
    for index in range(2):
        frame = env.frame(index)
        assert (frame.step, frame.time, frame.density) == (0, 0.0, 0.0)
        assert_array_equal(frame.pose, env.world.state.pose[index])
        # The outermost start places of the home are on its edge, which belongs to the floor.
        column, row = (frame.pose[:, :2] / env.arena.cell_size).astype(int).T
        at_home = env.arena.zones[row, column] == Zone.HOME
        assert_array_equal(frame.mode, np.where(at_home, Mode.EXIT_HOME, Mode.GOING_TO_DIG))
        assert frame.action.tolist() == [4] * 3
        assert not frame.laden.any()
        assert not frame.reward.any()
        assert not frame.delivered.any()
        assert not frame.pheromone.any()
        assert frame.pheromone.shape == env.arena.zones.shape
        assert frame.pellets.shape == (60, 2)
        assert frame.pellet_status.tolist() == [0] * 60
        assert frame.contacts.kind.size == 0


def test_a_frame_is_what_the_step_returned_and_what_the_observations_show() -> None:
    env = VectorEnv("paper", robots=4, num_envs=2, episode_steps=500)
    observation = env.reset(0)
    lanes = make_controller("lanes")
    lanes.reset(env)
    own = {name: index for index, name in enumerate(env.layout.names)}
    width, height = env.arena.size
    held_at_some_time = np.zeros((2, 4), dtype=np.bool_)
    for step in range(1, 251):
        actions = lanes.act(env, observation)
        transition = env.step(actions)
        observation, reward, delivered = (
            transition.observation, transition.reward, transition.final_delivered,
        )  # fmt: skip
        for index in range(2):
            frame, seen = env.frame(index), observation[index]
            assert frame.step == step
            assert frame.time == pytest.approx(0.3 * step)
            assert_array_equal(frame.action, actions[index])
            assert_array_equal(frame.reward, reward[index])
            assert_array_equal(frame.delivered, delivered[index])
            assert_array_equal(frame.laden, seen[:, own["laden"]])
            assert_array_equal(frame.mode, seen[:, :7].argmax(axis=1))
            assert seen[:, own["x"]] == pytest.approx(frame.pose[:, 0] / width)
            assert seen[:, own["y"]] == pytest.approx(frame.pose[:, 1] / height)
            assert seen[:, own["tunnel density"]] == pytest.approx(frame.density)
            assert frame.pellet_status.tolist().count(1) == frame.laden.sum()
            for robot in range(4):
                column, row = (frame.pose[robot, :2] / env.arena.cell_size).astype(int)
                assert seen[robot, own["occupancy (+0, +0)"]] == pytest.approx(frame.pheromone[row, column])
            contacts = frame.contacts
            assert (contacts.env == index).all()
            assert (contacts.time <= frame.time + 1e-9).all()
            assert (contacts.time > frame.time - 0.3 + 1e-9).all()
            held_at_some_time[index] |= frame.laden
    assert held_at_some_time.all()
    assert env.delivered.sum() > 5


def test_after_autoreset_the_frame_is_the_new_episodes_first() -> None:
    env = VectorEnv("paper", robots=2, episode_steps=5)
    env.reset(0)
    first = env.frame().pose.copy()
    for _ in range(5):
        env.step([[0, 1]])
    frame = env.frame()
    assert frame.step == 0
    assert frame.action.tolist() == [4, 4]
    assert not frame.reward.any()
    assert not np.array_equal(frame.pose, first)


def test_without_autoreset_the_last_frame_stays_to_be_read() -> None:
    env = VectorEnv("paper", robots=2, episode_steps=5, autoreset=False)
    env.reset(0)
    for _ in range(5):
        last = env.step([[0, 1]])
    assert env.frame().step == 5
    assert_array_equal(env.frame().reward, last.reward[0])
