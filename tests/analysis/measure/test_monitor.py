"""Watching as such: chunks, memory, order of frames, and evaluations that are watched."""

import pickle
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from robosim.analysis.measure.metrics import METRICS
from robosim.analysis.measure.monitor import CHUNK, EpisodeMonitor, TeamMonitor, delivered_over_time
from robosim.analysis.measure.tunnels import find_tunnels
from robosim.arena import load_arena
from robosim.control.controller import RandomController, make_controller
from robosim.control.evaluate import evaluate
from robosim.envs.vector import VectorEnv
from tests.analysis.handmade import (
    PERIOD,
    REAL,
    Reckless,
    Run,
    Script,
    columns_for,
    crowds,
    differences,
    middle,
    real,
    runs,
    watch,
)


@pytest.mark.parametrize("name", REAL)
def test_how_frames_are_cut_into_chunks_changes_no_bit(name):
    run = real(name)
    whole = run.watch(len(run.frames))
    assert len(run.frames) > 400
    for size in (1, 7, 64, 500):
        assert differences(whole, run.watch(size)) == []
    assert differences(whole, run.watch()) == []


@given(runs(), st.sampled_from([1, 2, 7, 13, 64]))
def test_nor_does_it_in_any_run(run, size):
    assert differences(run.watch(), run.watch(size)) == []


@settings(max_examples=60)
@given(crowds(), st.sampled_from([1, 2, 7, 13, 64]))
def test_nor_in_any_crowd(run, size):
    assert differences(run.watch(), run.watch(size)) == []


def test_differences_are_found_where_there_are_some():
    """The comparison of the tests above sees everything that an episode holds."""
    episode = real("reckless on three-wide").watch()
    assert differences(episode, episode) == []
    energy = episode.totals.energy.copy()
    energy[0] = np.nextafter(energy[0], 1.0)
    assert differences(episode, replace(episode, totals=episode.totals._replace(energy=energy))) != []
    assert differences(episode, replace(episode, standstills=episode.standstills[1:])) != []
    changed = replace(episode.traffic, track=episode.traffic.track + np.float32(1e-6))
    assert differences(episode, replace(episode, traffic=changed)) == ["episode.traffic.track"]


def test_frames_may_be_views_that_change_afterwards():
    run = real("lanes on two-tunnels")
    monitor = EpisodeMonitor(run.arena, run.robots)
    pose, delivered = np.empty_like(run.frames[0].pose), np.empty_like(run.frames[0].delivered)
    for frame in run.frames:
        pose[:], delivered[:] = frame.pose, frame.delivered
        monitor.add(replace(frame, pose=pose, delivered=delivered))
        pose[:], delivered[:] = np.nan, -1
    assert differences(run.watch(), monitor.finish()) == []


def test_frames_must_follow_each_other_from_the_first_on():
    frames = Script("paper", 1, 5).frames()
    monitor = EpisodeMonitor(load_arena("paper"), 1)
    with pytest.raises(ValueError, match="step 1 came where step 0"):
        monitor.add(frames[1])
    monitor.add(frames[0])
    monitor.add(frames[1])
    for wrong in (0, 1, 3):
        with pytest.raises(ValueError, match=f"step {wrong} came where step 2"):
            monitor.add(frames[wrong])
    monitor.add(frames[2])
    assert monitor.finish().decisions == 2


def test_so_must_chunks():
    script = Script("paper", 1, 9)
    chunks = []
    for begin in (0, 5):
        columns = columns_for(script.arena, 1, 5)
        for frame in script.frames()[begin : begin + 5]:
            columns.add(frame)
        chunks.append(columns)
    monitor = EpisodeMonitor(script.arena, 1)
    with pytest.raises(ValueError, match="step 5 came where step 0"):
        monitor.look(chunks[1])
    monitor.look(chunks[0])
    with pytest.raises(ValueError, match="step 0 came where step 5"):
        monitor.look(chunks[0])
    monitor.look(chunks[1])
    assert monitor.finish().decisions == 9


def test_a_run_of_just_a_chunk_or_one_more_is_whole():
    for steps in (CHUNK - 1, CHUNK, CHUNK + 1):
        script = Script("paper", 1, steps)
        script.pose[..., :2] = middle(12, 3)
        episode = script.watch()
        assert episode.decisions == episode.traffic.robots_in_tunnel.sum() == steps
        assert episode.totals.seconds.sum() == pytest.approx(steps * PERIOD)
        (visit,) = episode.traffic.visits
        assert visit.end == steps + 1


def _crammed(steps: int) -> Run:
    """Eight robots that stand in a tunnel and press on each other for ever."""
    script = Script("paper", 8, steps)
    for robot in range(8):
        script.pose[:, robot, :2] = middle(9 + 0.75 * robot, 3)
        script.action[1:, robot] = 3
        script.rub(range(1, steps + 1), robot)
        if robot:
            script.meet(range(1, steps + 1), robot - 1, robot)
    return Run(script.arena, 8, script.frames())


def _sizes(run: Run, at: tuple[int, ...]) -> list[int]:
    """Size of a monitor, and of all that it holds, after so many decisions."""
    monitor, sizes = EpisodeMonitor(run.arena, run.robots), []
    for frame in run.frames:
        monitor.add(frame)
        if frame.step in at:
            sizes.append(len(pickle.dumps(monitor, protocol=5)))
    return sizes


def test_memory_grows_with_the_points_that_are_kept_and_with_nothing_else():
    """Of eight robots that stand still, held up and in touch all the time."""
    begin, end = CHUNK, 10 * CHUNK
    one, ten = _sizes(_crammed(end + 1), (begin, end))
    # Each 1.5 s a step number, and of each robot a distance, a tunnel and a load; each 30 s three numbers.
    # Each 500 decisions the arrays that hold them, and each 120 s a number.
    points, windows, chunks = (end - begin) / 5, (end - begin) / 100, 9
    kept = points * (8 + 8 * (4 + 1 + 1)) + windows * 24
    around = chunks * 4 * 100 + windows * 100 + (end - begin) / 400 * 10
    assert kept <= ten - one <= kept + around + 2000
    assert ten - one < 0.04 * (end - begin) * (8 * 3 * 8 + 15 * 50), "a few per cent of the frames"


def test_memory_is_not_held_by_views_of_chunks():
    """Pickling cannot distinguish a row from a view of the array that it belongs to; the allocator can."""
    run = _crammed(6 * CHUNK)
    monitor, sizes = EpisodeMonitor(run.arena, run.robots), []
    tracemalloc.start()
    try:
        for frame in run.frames:
            monitor.add(frame)
            if frame.step % CHUNK == CHUNK // 2:
                sizes.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    growth = np.diff(sizes[1:])
    a_chunk_of_poses = CHUNK * 8 * 3 * 8
    assert (growth < 0.2 * a_chunk_of_poses).all()


class Seen:
    """Hears of everything that a watched evaluation reports, and keeps the bits of the run."""

    def __init__(self) -> None:
        self.poses, self.ends = [], []

    def begin(self, env):
        self.poses.append(env.world.state.pose.copy())

    def step(self, env):
        self.poses.append(env.world.state.pose.copy())
        self.poses.append(env.world.state.velocity.copy())

    def end(self, env, wanted):
        self.ends.append((env.delivered.copy(), wanted))


def _team(num_envs=2, episode_steps=150, arena="single-lane"):
    return VectorEnv(arena, robots=4, num_envs=num_envs, episode_steps=episode_steps)


def test_episodes_are_those_of_the_evaluation():
    """Three of four: the surplus one is left out."""
    monitor = TeamMonitor()
    evaluation = evaluate(make_controller("lanes"), _team(episode_steps=260), 3, seed=2, watch=[monitor])
    assert len(monitor.episodes) == len(monitor.trajectories) == 3
    delivered = [tuple(episode.totals.delivered.tolist()) for episode in monitor.episodes]
    assert tuple(delivered) == evaluation.delivered
    assert sum(map(sum, delivered)) > 0
    for episode in monitor.episodes:
        assert (episode.robots, episode.decisions) == (4, 260)
        assert [trip.pellets for trip in episode.trips].count(0) == 0
        counted = [sum(trip.pellets for trip in episode.trips if trip.robot == robot) for robot in range(4)]
        assert counted == episode.totals.delivered.tolist()
        assert (episode.totals.energy > 0.0).all(), "wheels are metered"


def test_watching_changes_no_bit_of_the_run():
    alone, beside = Seen(), Seen()
    plain = evaluate(Reckless(), _team(), 3, seed=2, watch=[alone])
    watched = evaluate(Reckless(), _team(), 3, seed=2, watch=[TeamMonitor(), beside])
    assert plain == watched
    assert plain == evaluate(Reckless(), _team(), 3, seed=2)
    assert len(alone.poses) == len(beside.poses)
    for one, other in zip(alone.poses, beside.poses, strict=True):
        assert_array_equal(one, other)
    assert [wanted for _, wanted in alone.ends] == [2, 1]


def test_an_episode_of_a_batch_is_what_it_is_alone():
    """Watched among others, and played again from its trajectory."""
    monitor = TeamMonitor()
    evaluate(Reckless(), _team(num_envs=3), 3, seed=2, watch=[monitor])
    for episode, trajectory in zip(monitor.episodes, monitor.trajectories, strict=True):
        env = VectorEnv("single-lane", robots=4, seed=[trajectory.seed], episode_steps=150, autoreset=False)
        env.reset()
        env.world.meter()
        alone = EpisodeMonitor(env.arena, 4)
        alone.add(env.frame())
        for actions in trajectory.chosen:
            env.step(actions[None])
            alone.add(env.frame())
        again = replace(alone.finish(), arena=episode.arena)
        assert differences(episode, again) == []


def test_one_monitor_may_watch_evaluations_of_different_arenas():
    monitor = TeamMonitor()
    for arena in ("single-lane", "two-tunnels"):
        evaluate(RandomController(), _team(1, 10, arena), 1, watch=[monitor])
    assert [episode.tunnels.count for episode in monitor.episodes] == [1, 2]
    assert [episode.arena.name for episode in monitor.episodes] == ["single-lane", "two-tunnels"]


def test_tunnels_are_looked_for_once():
    monitor = TeamMonitor()
    evaluate(RandomController(), _team(2, 5), 4, watch=[monitor])
    assert len({id(episode.tunnels) for episode in monitor.episodes}) == 1
    run = real("lanes on two-tunnels")
    tunnels = find_tunnels(run.arena)
    assert EpisodeMonitor(run.arena, run.robots, tunnels).tunnels is tunnels


def test_deliveries_over_time():
    script = Script("paper", 2, 30)
    script.delivered[10:, 1] = 2
    script.delivered[20:, 0] = 1
    script.delivered[20:, 1] = 3
    steps, counts = delivered_over_time(script.watch())
    assert steps.tolist() == [0, 10, 20, 20]
    assert counts.tolist() == [[0, 0], [0, 2], [1, 2], [1, 3]]
    steps, counts = delivered_over_time(Script("paper", 2, 30).watch())
    assert (steps.tolist(), counts.tolist()) == ([0], [[0, 0]])


def test_metrics_do_not_depend_on_the_order_of_robots():
    """Numbers are names: the same run with the robots in another order has the same metrics."""
    run = real("reckless on three-wide")
    order = np.roll(np.arange(run.robots), 3)
    number = np.argsort(order)
    frames = [_renumbered(frame, order, number) for frame in run.frames]
    episode, other = run.watch(), watch(run.arena, run.robots, frames)
    for metric in METRICS:
        assert metric.compute(other) == pytest.approx(metric.compute(episode)), metric.name
    spans = [
        [(clog.start, clog.end, clog.cause, clog.ending) for clog in one.standstills]
        for one in (episode, other)
    ]
    assert spans[0] == spans[1]


def _renumbered(frame, order, number):
    contacts = frame.contacts
    between = contacts.kind == 0
    a, b = number[contacts.a], np.where(between, number[np.where(between, contacts.b, 0)], contacts.b)
    contacts = replace(
        contacts, a=np.where(between, np.minimum(a, b), a), b=np.where(between, np.maximum(a, b), b)
    )
    each = ("pose", "mode", "laden", "action", "delivered", "energy", "reward")
    return replace(frame, contacts=contacts, **{name: getattr(frame, name)[order] for name in each})
