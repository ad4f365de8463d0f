"""A log worked through again holds what its controller held, and a stranger's log ends in a sentence."""

import json
import random

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from robosim.deploy.log import read_log
from robosim.deploy.retrace import Retrace
from robosim.errors import InputError
from robosim.robot.drivers import CARDINAL_STEPS, STOP
from tests.deploy.logs import logged_run


@pytest.mark.parametrize("policy", ["relay-4", "paper-4-wheels"])
def test_what_a_controller_held_is_worked_out_again_to_the_last_bit(tmp_path, policy):
    held = []

    def watch(controller):
        team = controller._team
        held.append((team.pose.copy(), team.shown_mode.copy(), team.occupancy.copy(), team.actions.copy()))

    commands = logged_run(tmp_path / "run.jsonl", policy=policy, watch=watch)
    retrace = Retrace(tmp_path / "run.jsonl")
    number = 0
    for number, (frame, (pose, mode, occupancy, actions), command) in enumerate(
        zip(retrace.frames(), held, commands, strict=True), 1
    ):
        assert_array_equal(frame.pose, pose)
        assert_array_equal(frame.mode, mode)
        assert_array_equal(frame.pheromone, occupancy)
        assert_array_equal(frame.action, actions)
        assert_array_equal(frame.wheel_speeds, command.wheel_speeds)
        assert frame.stopped == command.stopped
        assert frame.begins == (number in {1, 71})
    assert number == 90
    assert (retrace.decisions, retrace.vouched, retrace.first_unlike) == (31, 31, None)
    assert held[60][2].max() > 0.1


def test_chosen_cells_are_the_neighbours_that_actions_name(tmp_path):
    logged_run(tmp_path / "run.jsonl", periods=60)
    retrace = Retrace(tmp_path / "run.jsonl")
    cell = retrace.arena.cell_size
    chosen = 0
    for frame in retrace.frames():
        for robot in range(2 * frame.decides):
            if frame.action[robot] == STOP:
                assert np.isnan(frame.target[robot]).all()
                continue
            here = frame.pose[robot, :2] // cell
            assert_array_equal(frame.target[robot] // cell, here + CARDINAL_STEPS[frame.action[robot]])
            chosen += 1
    assert chosen > 20


def test_what_the_log_does_not_vouch_for_is_noticed(tmp_path):
    path = tmp_path / "run.jsonl"
    logged_run(path, periods=30)
    lines = path.read_text().splitlines()
    table = json.loads(lines[13])
    assert table["period"] == 12
    table["laden"][0] = not table["laden"][0]
    lines[13] = json.dumps(table)
    path.write_text("\n".join(lines) + "\n")
    retrace = Retrace(path)
    assert len(list(retrace.frames())) == 30
    assert (retrace.decisions, retrace.first_unlike) == (10, 4)
    assert 4 <= retrace.vouched < 10


def test_without_a_map_of_its_own_none_is_worked_out(tmp_path):
    path = tmp_path / "run.jsonl"
    logged_run(path, periods=9)
    path.write_text(path.read_text().replace('"map": "own"', '"map": "shared"', 1))
    assert [frame.pheromone for frame in Retrace(path).frames()] == [None] * 9


@pytest.mark.parametrize(
    ("line", "change", "sentence"),
    [
        (1, {"env": {"robots": 0}}, "line 1: env.robots is 0, but must be a whole number from 1 to 1000."),
        (1, {"map": "other"}, 'line 1: map is "other", but must be "own" or "shared".'),
        (2, {"pose": [[0.5], []]}, "line 2: pose is [[0.5], []], but must be numbers in the shape [2, 3]."),
        (2, {"actions": [0, 5]}, "line 2: actions is [0, 5], but must be whole numbers from 0 to 4."),
        (2, {"actions": None}, "line 2: a run begins without a decision."),
        (2, {"begins": False}, "line 2: no run begins with the first control period."),
        (2, {"pose": [[0.7, 0.5, 0], [-1, 0, 0]]}, "line 2: robot 1 is not on the map as a run begins."),
        (3, {"now": 1e300}, "line 3: now is 1e+300, but must be within 1e+09 s of the first line's."),
        (3, {"stopped": [""]}, 'line 3: stopped is [""], but must be a list of 2 texts.'),
        (3, {"pilot": 1}, "line 3: \"pilot\" is not an option: "),
        (3, {"gripper": [0, 3]}, "line 3: gripper is 3, but must be "),
    ],
)  # fmt: skip
def test_a_line_that_no_controller_writes_is_a_sentence(tmp_path, line, change, sentence):
    path = tmp_path / "run.jsonl"
    logged_run(path, periods=4)
    lines = path.read_text().splitlines()
    table = json.loads(lines[line - 1])
    nested = {
        name: table[name] | value if isinstance(value, dict) else value for name, value in change.items()
    }
    lines[line - 1] = json.dumps(table | nested)
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError) as caught:
        list(Retrace(path).frames())
    assert str(caught.value).startswith(f"{path}: {sentence}")
    assert "\n" not in str(caught.value)


def test_an_arena_in_a_log_is_text_and_no_file(tmp_path):
    path = tmp_path / "run.jsonl"
    logged_run(path, periods=1)
    head, _, rest = path.read_text().partition("\n")
    table = json.loads(head)
    table["env"]["arena"] = "paper"
    path.write_text(json.dumps(table) + "\n" + rest)
    with pytest.raises(InputError) as caught:
        Retrace(path)
    assert str(caught.value).startswith(f"{path}: arena: ")


def damaged(rng, text):
    """Return a log with some bytes, values or lines changed."""
    lines = text.splitlines()
    kind = rng.randrange(4)
    number = rng.randrange(len(lines))
    if kind == 0:
        place = rng.randrange(len(text))
        return text[:place] + chr(rng.randrange(1, 300)) * rng.randrange(3) + text[place + rng.randrange(3) :]
    if kind == 1:
        del lines[number]
    else:
        table = json.loads(lines[number])
        key = rng.choice(list(table))
        table[key] = changed(rng, table[key])
        lines[number] = json.dumps(table)
    return "\n".join(lines) + "\n"


def changed(rng, value):
    if isinstance(value, list) and value and rng.random() < 0.7:
        value = list(value)
        place = rng.randrange(len(value))
        value[place] = changed(rng, value[place])
        return value
    if isinstance(value, dict) and rng.random() < 0.9:
        key = rng.choice(list(value))
        return value | {key: changed(rng, value[key])}
    return rng.choice(
        [
            *(None, [], {}, "", "x" * 1000, "\x1b[2J", True, [[1]], [None] * 3, value),
            *(-1, 0, 3, 10**30, 10**400, -1e308, 1e308, 0.5),
        ]
    )


def test_a_damaged_log_is_read_or_refused_in_a_sentence(tmp_path):
    """A few of them here."""
    path = tmp_path / "run.jsonl"
    logged_run(path, periods=7)
    text, read = path.read_text(), 0
    for seed in range(40):
        path.write_text(damaged(random.Random(seed), text))
        try:
            for frame in Retrace(path).frames():
                assert frame.pose.shape == (2, 3)
            read += 1
        except InputError as error:
            assert "\n" not in str(error), seed
    assert 3 < read < 37


def test_a_line_without_end_is_not_held(tmp_path, monkeypatch):
    path = tmp_path / "run.jsonl"
    monkeypatch.setattr("robosim.deploy.log._LONGEST_HEAD", 1000)
    path.write_text("[" * 2000)
    with pytest.raises(InputError) as caught:
        list(read_log(path))
    assert str(caught.value) == f"{path}: line 1 is longer than 1000 bytes, the most it may have."
