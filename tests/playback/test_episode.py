from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rerun.chunk import RrdReader

from robosim.arena import arena_names, load_arena
from robosim.control.controller import RandomController
from robosim.control.lanes import LanesController
from robosim.discretise.pheromone import PheromoneConfig
from robosim.envs.vector import VectorEnv
from robosim.episodes.replay import replay
from robosim.episodes.trajectory import load_trajectory
from robosim.errors import InputError
from robosim.playback.bodies import POSITION_GRID
from robosim.playback.clogs import decisions_until_certain
from robosim.playback.episode import record_episode, record_trajectory, widened
from robosim.playback.writer import REWARD_STEPS
from tests.playback.reading import Reading, plain


class InterruptedController(RandomController):
    """Stands for a person who presses Ctrl-C while the eighth decision is made."""

    def act(self, env, observation):
        if env.steps_taken == 7:
            raise KeyboardInterrupt
        return super().act(env, observation)


def _env(**changes):
    return VectorEnv("paper", **{"robots": 2, "seed": 3, "episode_steps": 30, "autoreset": False, **changes})


def _rows(path, entity):
    rows = {}
    for chunk in RrdReader(path).stream():
        if chunk.entity_path == entity and not chunk.is_static:
            batch = chunk.to_record_batch()
            assert not rows
            rows = {name: batch.column(name).to_pylist() for name in batch.schema.names}
    return rows


def test_recording_shows_the_episode_that_the_same_seed_gives_without_it(tmp_path):
    path = tmp_path / "run.rrd"
    heard = []
    env = _env()
    recorded = record_episode(
        RandomController(1), env, path, on_step=lambda step, delivered: heard.append((step, delivered))
    )
    assert recorded == (30, 0)
    assert heard == [(step, 0) for step in range(1, 31)]

    plain, controller = _env(), RandomController(1)
    observation = plain.reset()
    controller.reset(plain)
    poses = [plain.frame().pose.copy()]
    for _ in range(30):
        observation = plain.step(controller.act(plain, observation)).observation
        poses.append(plain.frame().pose.copy())
    assert (env.frame().pose == poses[-1]).all(), "recording does not touch the run"
    for robot in range(2):
        rows = _rows(path, f"/arena/robots/{robot}")
        assert rows["step"][0] == 0
        for step, place in zip(rows["step"], rows["Transform3D:translation"], strict=True):
            assert place[0][:2] == pytest.approx(poses[step][robot, :2], abs=1e-6)


def test_an_interrupted_episode_is_kept_as_far_as_it_came(tmp_path):
    path = tmp_path / "run.rrd"
    assert record_episode(InterruptedController(), _env(), path).decisions == 7
    assert _rows(path, "/plots/delivered")["step"] == [0, 7]


def test_nothing_runs_when_the_file_cannot_be_written(tmp_path):
    env = _env()
    with pytest.raises(InputError, match="cannot be written"):
        record_episode(RandomController(), env, tmp_path / "nowhere" / "run.rrd")
    assert env.episode == -1


def test_an_environment_that_would_run_on_is_refused(tmp_path):
    with pytest.raises(ValueError, match="autoreset=False"):
        record_episode(RandomController(), _env(autoreset=True), tmp_path / "run.rrd")


def test_recorder_takes_every_arena_that_ships(tmp_path):
    for name in arena_names():
        path = tmp_path / f"{name}.rrd"
        env = VectorEnv(name, robots=1, episode_steps=2, autoreset=False)
        record_episode(RandomController(), env, path)
        reader = RrdReader(path)
        assert (len(reader.recordings()), len(reader.blueprints())) == (1, 1)
        assert _rows(path, "/arena/robots/0")["step"][0] == 0


STEPS = 450


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    """A recording of lanes made live, and its trajectory, with pheromones and rewards of its own."""
    folder = tmp_path_factory.mktemp("live")
    env = _env(
        robots=5,
        episode_steps=STEPS,
        pheromone=PheromoneConfig(decay=0.05, reinforcement=0.3, initial=0.1, diffusion=0.1, radius=1),
        reward="local",
        signed_distance=True,
    )
    recorded = record_episode(LanesController(), env, folder / "live.rrd", about={"policy": "lanes"})
    assert recorded.decisions == STEPS
    assert recorded.delivered > 10
    env.trajectory(policy="lanes").save(folder / "run.npz")
    return Reading(folder / "live.rrd"), load_trajectory(folder / "run.npz"), recorded


def test_a_trajectory_run_again_gives_the_recording_made_live(tmp_path, live):
    whole, trajectory, recorded = live
    heard = []
    path = tmp_path / "again.rrd"
    again = record_trajectory(
        trajectory, path, about={"policy": "lanes"}, on_step=lambda step, delivered: heard.append(step)
    )
    assert again == recorded
    assert heard == list(range(1, STEPS + 1))
    found = Reading(path)
    assert found.rows.keys() == whole.rows.keys()
    for entity, rows in found.rows.items():
        assert plain(rows) == plain(whole.rows[entity]), entity
    assert found.static.keys() == whole.static.keys()
    for entity in found.static:
        # Holds when the file was made.
        if entity != "/__properties":
            assert found.static[entity] == whole.static[entity], entity


@pytest.mark.parametrize(
    ("spans", "kept"),
    [
        ([(0, 1)], [(0, 20)]),
        ([(405, 10**6), (130, 150), (41, 60), (59, 62)], [(40, 80), (120, 160), (400, STEPS + 1)]),
        ([(401, 402), (STEPS, STEPS + 1)], [(400, 420), (440, STEPS + 1)]),
    ],
)
def test_spans_are_recorded_as_in_the_recording_of_all(tmp_path, live, spans, kept):
    whole, trajectory, _ = live
    path = tmp_path / "spans.rrd"
    heard = []
    recorded = record_trajectory(
        trajectory, path, spans=spans, on_step=lambda step, delivered: heard.append(step)
    )
    # It goes on until all clogs of the last span are decided.
    last = min(kept[-1][1] - 1 + decisions_until_certain(load_arena("paper")), STEPS)
    assert recorded.decisions == last
    assert heard == list(range(1, last + 1))
    found = Reading(path)
    steps = np.concatenate([np.arange(start, end) for start, end in kept])
    for entity, name in [
        *((f"/modes/robot_{robot}", "StateChange:state") for robot in range(5)),
        ("/arena/tracks", "Points2D:positions"),
        ("/arena/pheromone", "SegmentationImage:buffer"),
        ("/plots/delivered_by_robot", "Scalars:scalars"),
        ("/plots/tunnel_density", "Scalars:scalars"),
    ]:
        assert found.shown(entity, name, steps) == whole.shown(entity, name, steps), entity
    for robot in range(5):
        # The first row of a span is new, so it may be nearer to the truth than the whole's.
        entity, name = f"/arena/robots/{robot}", "Transform3D:translation"
        apart = np.array(found.shown(entity, name, steps)) - whole.shown(entity, name, steps)
        assert np.abs(apart).max() <= POSITION_GRID * 1.01
    ends = {end for _, end in kept if end <= STEPS}
    for entity, rows in found.rows.items():
        assert set(rows["step"]) - set(steps) == (ends if entity.startswith("/modes") else set()), entity
    paid = [frame.reward.mean(dtype=np.float64) for frame in replay(trajectory)]
    reward, expected = found.rows["/plots/reward"], whole.rows["/plots/reward"]
    assert reward["step"].tolist() == [step for step in expected["step"] if step in steps]
    for step, mean in zip(reward["step"], reward["Scalars:scalars"], strict=True):
        first = max(step + 1 - REWARD_STEPS, *(start for start, end in kept if start <= step), 0)
        assert mean[0] == pytest.approx(np.mean(paid[first : step + 1]))


def test_no_spans_are_a_recording_of_the_arena_for_which_nothing_runs(tmp_path, live):
    _, trajectory, _ = live
    for spans in ([], [(STEPS + 1, STEPS + 9)]):
        path = tmp_path / "none.rrd"
        assert record_trajectory(trajectory, path, spans=spans) == (0, 0)
        found = Reading(path)
        assert found.rows == {}
        assert "/arena/map" in found.static


@pytest.mark.parametrize("span", [(-1, 5), (5, 5), (7, 3)])
def test_a_span_that_is_none_is_refused_before_anything_is_written(tmp_path, live, span):
    with pytest.raises(ValueError, match=r"span \(.*\): it must begin at 0 or later, and end after that"):
        record_trajectory(live[1], tmp_path / "run.rrd", spans=[(0, 4), span])
    assert list(tmp_path.iterdir()) == []


@given(
    st.lists(st.tuples(st.integers(0, 300), st.integers(1, 90)), max_size=6),
    st.integers(0, 250),
)
def test_widened_spans_hold_what_was_asked_for_and_little_more(wanted, decisions):
    spans = [(start, start + length) for start, length in wanted]
    found = widened(spans, decisions)
    asked = {step for start, end in spans for step in range(start, end) if step <= decisions}
    held = {step for start, end in found for step in range(start, end)}
    assert asked <= held <= set(range(decisions + 1))
    for step in held:
        assert any(abs(step - one) < REWARD_STEPS for one in asked)
    for start, end in found:
        assert start % REWARD_STEPS == 0
        assert end % REWARD_STEPS == 0 or end == decisions + 1
    assert all(before[1] < after[0] for before, after in pairwise(found))
    assert widened(None, decisions) == [(0, decisions + 1)]


def test_an_interrupted_trajectory_is_kept_as_far_as_it_came(tmp_path, live):
    def interrupt(step, delivered):
        if step == 50:
            raise KeyboardInterrupt

    path = tmp_path / "run.rrd"
    recorded = record_trajectory(live[1], path, on_step=interrupt)
    assert recorded.decisions == 50
    assert Reading(path).rows["/plots/delivered"]["step"][-1] == 50


def test_a_trajectory_that_cannot_run_is_one_sentence_and_no_file(tmp_path, live):
    many = live[1].config.changed(robots=99)
    trajectory = replace(live[1], config=many, chosen=np.zeros((3, 99), dtype=np.uint8))
    with pytest.raises(InputError, match=r"^run\.npz: robots is 99, but must be a whole number"):
        record_trajectory(trajectory, tmp_path / "run.rrd", source="run.npz")
    with pytest.raises(InputError, match="cannot be written"):
        record_trajectory(live[1], tmp_path / "nowhere" / "run.rrd")
    assert list(tmp_path.iterdir()) == []
