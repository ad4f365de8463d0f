"""A controller's log explains every command, and never stands in the way of one."""

import json
from contextlib import closing

import pytest
from numpy.testing import assert_array_equal

from robosim.control.policy import load_policy
from robosim.deploy import Controller, DecisionLog
from robosim.deploy.log import read_log, run_again
from robosim.deploy.retrace import Retrace
from robosim.deploy.simulated import SimulatedRobots
from robosim.errors import InputError
from tests.deploy.logs import logged_run


def test_the_log_holds_what_went_in_and_out_to_the_last_bit(tmp_path):
    commands = logged_run(tmp_path / "run.jsonl")
    logged = list(read_log(tmp_path / "run.jsonl"))
    assert len(logged) == len(commands) == 90
    for one, command in zip(logged, commands, strict=True):
        assert_array_equal(one.wheel_speeds, command.wheel_speeds)
        assert_array_equal(one.gripper, command.gripper)
        assert one.stopped == command.stopped
        assert (one.actions is None) == (command.actions is None) == (one.observation == "")
        if command.actions is not None:
            assert_array_equal(one.actions, command.actions)
    assert logged[22].stopped == ("", "no pose")
    assert logged[45].stopped == ("a test", "a test")
    assert [one.unstopped.tolist() for one in logged] == [one.unstopped.tolist() for one in commands]
    hashes = [one.observation for one in logged if one.observation]
    assert len(hashes) == 31
    assert len(set(hashes)) > 20
    first = json.loads((tmp_path / "run.jsonl").read_text().partition("\n")[0])
    assert (first["policy"], first["max_age"], first["env"]["robots"]) == ("paper-2", 0.5, 2)


def test_a_run_is_commanded_again_from_its_log_to_the_last_bit(tmp_path):
    logged_run(tmp_path / "run.jsonl")
    again = DecisionLog(tmp_path / "again.jsonl")
    controller = Controller(load_policy("paper-2"), log=again, name="paper-2")
    for logged, command in run_again(tmp_path / "run.jsonl", controller):
        assert_array_equal(logged.wheel_speeds, command.wheel_speeds)
    again.close()
    # All of it: what robots observed, too.
    assert (tmp_path / "again.jsonl").read_text() == (tmp_path / "run.jsonl").read_text()


def test_a_log_tells_a_run_that_begins_from_a_period_that_is_given_twice(tmp_path):
    """By a line's own word: the number of its period is the same either way."""
    with closing(DecisionLog(tmp_path / "run.jsonl")) as log:
        controller = Controller(load_policy("paper-2"), log=log, name="paper-2")
        robots = SimulatedRobots(controller.config, seed=4)
        for period, resets in [(0, False), (0, True), (0, False), (1, False), (2, False), (2, False)]:
            if resets:
                controller.reset()
            robots.obey(controller.step(robots.readings(), robots.now, period))
    assert [one.begins for one in read_log(tmp_path / "run.jsonl")] == [
        True,
        True,
        False,
        False,
        False,
        False,
    ]
    for logged, command in run_again(tmp_path / "run.jsonl", Controller(load_policy("paper-2"))):
        assert_array_equal(logged.wheel_speeds, command.wheel_speeds)
    retrace = Retrace(tmp_path / "run.jsonl")
    assert [frame.begins for frame in retrace.frames()] == [True, True, False, False, False, False]
    assert (retrace.decisions, retrace.vouched) == (2, 2)


def test_other_weights_do_not_explain_a_log(tmp_path):
    logged_run(tmp_path / "run.jsonl")
    pairs = run_again(tmp_path / "run.jsonl", Controller(load_policy("any"), robots=2))
    assert any((logged.wheel_speeds != command.wheel_speeds).any() for logged, command in pairs)


def test_a_last_line_cut_short_is_left_out_and_a_damaged_one_is_refused(tmp_path):
    path = tmp_path / "run.jsonl"
    logged_run(path, periods=5)
    whole = path.read_text()
    path.write_text(whole[:-30])
    assert len(list(read_log(path))) == 4
    lines = whole.splitlines(keepends=True)
    path.write_text("".join([*lines[:3], lines[3][:40] + "\n", *lines[4:]]))
    with pytest.raises(InputError) as caught:
        list(read_log(path))
    assert str(caught.value) == f"{path}: line 4 is not a line of a controller's log."


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "holds no whole line, so it is no controller's log."),
        ("[1]\n", "line 1 is not a line of a controller's log."),
        ('{"format": "robosim-log", "version": 9}\n', "not a controller's log of version 1."),
    ],
)
def test_another_file_is_no_log(tmp_path, text, sentence):
    path = tmp_path / "run.jsonl"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        list(read_log(path))
    assert str(caught.value) == f"{path}: {sentence}"


def test_a_log_is_never_written_over(tmp_path):
    path = tmp_path / "run.jsonl"
    path.touch()
    with pytest.raises(InputError) as caught:
        DecisionLog(path)
    assert str(caught.value) == f"{path}: is there already; a log is never written over."
    with pytest.raises(InputError) as caught:
        DecisionLog(tmp_path / "nowhere" / "run.jsonl")
    assert str(caught.value) == f"{tmp_path}/nowhere/run.jsonl: cannot be written: No such file or directory."


def test_robots_are_driven_on_where_the_log_cannot_be_written(tmp_path):
    log = DecisionLog(tmp_path / "run.jsonl")
    controller = Controller(load_policy("paper-2"), log=log)
    robots = SimulatedRobots(controller.config, seed=4)
    log.close()
    for _ in range(4):
        robots.obey(controller.step(robots.readings(), robots.now))
    assert log.failed == f"{log.path}: the log ends early: I/O operation on closed file."


@pytest.mark.parametrize("periods", [range(45), range(1, 46), [0, 1, 2, 5, 6, 7, *range(9, 40)]])
def test_stops_and_periods_of_any_kind_are_commanded_again(tmp_path, periods):
    """Stops that begin and end between two periods, a second one with another reason, periods left out."""
    path = tmp_path / "run.jsonl"
    log = DecisionLog(path)
    controller = Controller(load_policy("paper-2"), log=log, name="paper-2")
    robots = SimulatedRobots(controller.config, seed=4)
    for call, period in enumerate(periods):
        if call == 10:
            controller.emergency_stop("at once over")
            controller.resume()
        if call in (15, 18):
            controller.emergency_stop(f"from {call} on")
        if call == 24:
            controller.resume()
            controller.emergency_stop("anew")
        if call == 28:
            controller.resume()
        robots.obey(controller.step(robots.readings(), robots.now, period))
    log.close()
    again = Controller(load_policy("paper-2"))
    pairs = list(run_again(path, again))
    assert len(pairs) == len(periods)
    for logged, command in pairs:
        assert_array_equal(logged.wheel_speeds, command.wheel_speeds)
        assert logged.stopped == command.stopped
    retrace = Retrace(path)
    assert len(list(retrace.frames())) == len(periods)
    assert retrace.vouched == retrace.decisions > 10


def test_a_log_whose_map_was_kept_elsewhere_is_not_commanded_again(tmp_path):
    path = tmp_path / "run.jsonl"
    logged_run(path, periods=3)
    path.write_text(path.read_text().replace('"map": "own"', '"map": "shared"'))
    with pytest.raises(InputError) as caught:
        list(run_again(path, Controller(load_policy("paper-2"))))
    assert str(caught.value) == (
        f"{path}: its pheromone map was kept elsewhere, so the run cannot be commanded again."
    )


def test_a_log_of_nothing_is_not_in_the_path_of_the_next_start(tmp_path):
    for _ in range(2):
        log = DecisionLog(tmp_path / "run.jsonl")
        Controller(load_policy("paper-2"), log=log)
        log.close()
    assert not list(tmp_path.iterdir())
