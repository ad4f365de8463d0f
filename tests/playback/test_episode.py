import pytest
from rerun.chunk import RrdReader

from robosim.arena import arena_names
from robosim.control.controller import RandomController
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError
from robosim.playback.episode import record_episode


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
    taken = record_episode(
        RandomController(1), env, path, on_step=lambda step, delivered: heard.append((step, delivered))
    )
    assert taken == 30
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
    assert record_episode(InterruptedController(), _env(), path) == 7
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
