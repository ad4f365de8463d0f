import numpy as np
import pytest

from robosim.learning.metrics import MetricsLog, read_metrics, write_metrics


def test_rows_add_up_over_the_end_of_episodes(tmp_path):
    log = MetricsLog()
    # Two environments of one robot; the episode ends after the third decision, then delivers 1 and 0.
    for delivered, ended in (([0, 0], False), ([1, 0], False), ([2, 1], True), ([1, 0], False)):
        touched = np.array([[True], [False]])
        log.add(
            np.float32([[1.0], [2.0]]), np.array(delivered)[:, None], np.full(2, ended), touched, ~touched
        )
    row = log.cut("first team", 1, 1, 0.5, 1e-3, float("nan"))
    assert (row.step, row.stage_step, row.decisions, row.episode, row.delivered) == (8, 8, 8, 2, 4)
    assert row.reward == pytest.approx(1.5)
    assert row.collisions == row.blocked == 0.5
    log.begin_stage()
    # Two robots now, one of which learns.
    nobody = np.zeros((2, 2), bool)
    log.add(np.float32([[1.0], [0.0]]), np.array([[1, 0], [1, 1]]), np.full(2, False), nobody, ~nobody)
    row = log.cut("newcomer 2", 2, 1, 0.4, 1e-3, 0.25)
    assert (row.step, row.stage_step, row.episode, row.delivered) == (10, 2, 0, 3)
    assert (row.reward, row.collisions, row.blocked) == (0.5, 0.0, 1.0)
    path = tmp_path / "metrics.parquet"
    write_metrics(log.rows, path)
    again = read_metrics(path)
    assert again[1] == log.rows[1]
    assert np.isnan(again[0].loss)
