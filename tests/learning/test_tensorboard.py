import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from robosim.learning.metrics import Metrics
from robosim.learning.tensorboard import Curves


def row(step, reward, loss=0.5):
    return Metrics(
        step=step, decisions=500, episode=0, stage="together", stage_step=step, robots=2, learning=2,
        reward=reward, delivered=4, collisions=0.5, blocked=0.1, steps_per_second=321.0,
        figures={"loss": loss},
    )  # fmt: skip


def curve(folder, name):
    events = EventAccumulator(str(folder))
    events.Reload()
    return [(one.step, pytest.approx(one.value)) for one in events.Scalars(name)]


def test_tensorboard_reads_the_curves_and_forgets_what_was_written_beyond_a_checkpoint(tmp_path):
    folder = tmp_path / "tensorboard"
    curves = Curves(folder, 0)
    curves.add(row(500, 0.1, float("nan")))
    curves.add(row(1000, 0.2))
    curves.add(row(1500, 0.3))
    curves.close()
    assert curve(folder, "reward") == [(500, 0.1), (1000, 0.2), (1500, 0.3)]
    assert curve(folder, "loss") == [(1000, 0.5), (1500, 0.5)]
    assert curve(folder, "pellets_per_1000")[0] == (500, 8.0)
    resumed = Curves(folder, 1000)
    resumed.add(row(1500, 0.4))
    resumed.close()
    assert curve(folder, "reward") == [(500, 0.1), (1000, 0.2), (1500, 0.4)]
