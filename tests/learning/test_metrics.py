import numpy as np
import pyarrow.parquet as pq
import pytest

from robosim.learning.metrics import FIXED, MetricsLog, read_metrics, write_metrics


def test_rows_add_up_over_the_end_of_episodes(tmp_path):
    log = MetricsLog()
    # Two environments of one robot; the episode ends after the third decision, then delivers 1 and 0.
    for delivered, ended in (([0, 0], False), ([1, 0], False), ([2, 1], True), ([1, 0], False)):
        touched = np.array([[True], [False]])
        log.add(
            np.float32([[1.0], [2.0]]), np.array(delivered)[:, None], np.full(2, ended), touched, ~touched
        )
    log.note({"loss": float("nan"), "entropy": 1.5})
    row = log.cut("first team", 1, 1)
    assert row.figures["entropy"] == 1.5
    assert (row.step, row.stage_step, row.decisions, row.episode, row.delivered) == (8, 8, 8, 2, 4)
    assert row.reward == pytest.approx(1.5)
    assert row.collisions == row.blocked == 0.5
    log.begin_stage()
    # Two robots now, one of which learns.
    nobody = np.zeros((2, 2), bool)
    log.add(np.float32([[1.0], [0.0]]), np.array([[1, 0], [1, 1]]), np.full(2, False), nobody, ~nobody)
    assert log.sums.figures == {}
    log.note({"loss": 0.5})
    log.note({"loss": 0.25})
    log.note({})
    row = log.cut("newcomer 2", 2, 1)
    assert row.figures == {"loss": 0.25}
    assert (row.step, row.stage_step, row.episode, row.delivered) == (10, 2, 0, 3)
    assert (row.reward, row.collisions, row.blocked) == (0.5, 0.0, 1.0)
    path = tmp_path / "metrics.parquet"
    write_metrics(log.rows, path)
    again = read_metrics(path)
    assert again[1] == log.rows[1]
    assert again[0].figures == {"loss": pytest.approx(float("nan"), nan_ok=True), "entropy": 1.5}
    assert pq.read_table(path).column_names == [*FIXED, "loss", "entropy"]


def test_a_figure_named_as_a_column_is_refused():
    with pytest.raises(ValueError, match="must not be named"):
        MetricsLog().note({"reward": 1.0})


def test_robots_in_rows_of_their_own_count_as_the_environments_they_are_in():
    log = MetricsLog()
    # Two environments of one and three robots, each robot a row; the episode ends.
    touched = np.array([[True], [False], [True], [True]])
    reward, delivered = np.float32([[4.0], [1.0], [2.0], [1.0]]), np.array([[2], [0], [1], [0]])
    log.add(reward, delivered, np.full(4, True), touched, touched, 2)
    row = log.cut("together", 2, 2)
    assert (row.step, row.decisions, row.episode, row.delivered) == (2, 2, 2, 3)
    # Per robot and decision, per joint decision, and as a share of the robots.
    assert (row.reward, row.collisions, row.blocked) == (2.0, 1.5, 0.75)
