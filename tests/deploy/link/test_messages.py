"""Messages come back as they were sent, and nothing else is taken for one."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.deploy.link.messages import (
    MOST_BYTES,
    MOST_REASON,
    NO_POSE,
    NORTH_UP,
    Body,
    Clock,
    Deposit,
    Field,
    Header,
    Kind,
    MessageError,
    Order,
    Pose,
    Reading,
    Rest,
    Stage,
    WheelCommand,
    pack,
    patch_numbers,
    unpack,
)

HEADER_BYTES = 26
MESSAGES = {
    "clock": Clock(2**64 - 1, 12.3, 0.0, Stage.RUNNING, 5, (0, 7, 2**63)),
    "held": Clock(1, 1.0, 2.0, Stage.RUNNING, 5, (9, 8), 77, 66, (Rest.STANDS, Rest.MOVES), "smoke"),
    "pose": Pose(0.1, 1.5, -0.25, 3.0),
    "late": Pose(0.4, 1.5, -0.25, 3.0, 0.3),
    "lost": Pose(0.1, math.nan, math.nan, math.nan),
    "body": Body(0.3, laden=True, at_pellet=False, touched=(False, True, False), pellet=(1.0, 2.0)),
    "no pellet": Body(0.3, laden=False, at_pellet=True, touched=(True, False, True), pellet=None),
    "command": WheelCommand(0.1, -3.5, 12.5, -1),
    "stands": WheelCommand(0.1, 0.0, 0.0, 0, 77, Rest.STANDS),
    "stop": Order(reason="smoke"),
    "release": Order(release=77),
    "waiting": WheelCommand(NO_POSE, 0.0, 0.0, 0),
    "deposit": Deposit(9, 3, 4, NORTH_UP, marks=True, mode=6, laden=True, action=4),
    "reading": Reading(9, 1, 0.25, np.linspace(0, 1, 36, dtype=np.float32)),
    "field": Field(9, np.arange(6, dtype=np.float32).reshape(2, 3)),
}
BYTES = {
    "clock": 79, "held": 75, "pose": 40, "late": 40, "lost": 40, "body": 29, "no pellet": 29, "command": 34,
    "stands": 34, "stop": 14, "release": 9, "waiting": 34,
    "deposit": 13, "reading": 14 + 4 * 36, "field": 8 + 4 * 6,
}  # fmt: skip


@pytest.mark.parametrize("name", MESSAGES)
def test_a_message_comes_back_as_it_was_sent(name):
    message = MESSAGES[name]
    data = pack(message, 2, 77, 5, 1.25)
    assert len(data) == HEADER_BYTES + BYTES[name]
    header, read = unpack(data)
    assert header == Header(message.kind, 2, 77, 5, 1.25)
    assert type(read) is type(message)
    assert read.body() == message.body()


def changed(data, place, value):
    return data[:place] + bytes([value]) + data[place + 1 :]


POSE = pack(MESSAGES["pose"], 2, 77, 5, 1.25)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "too short"),
        (POSE[:25], "too short"),
        (POSE[:-1], "too short"),
        (POSE + b"x", "too long"),
        (bytes(MOST_BYTES + 1), "too long"),
        (b"XX" + POSE[2:], "not a message of robosim"),
        (changed(POSE, 2, 1), "of version 1, not 2"),
        (changed(POSE, 3, 0), "of an unknown kind"),
        (changed(POSE, 3, 9), "of an unknown kind"),
        (changed(POSE, 5, 255), "robot out of range"),
        (pack(MESSAGES["pose"], 0, 0, 1, 0.0), "from no process"),
        (pack(MESSAGES["pose"], 0, 1, 1, math.nan), "sent at no time"),
        (pack(Pose(0.0, math.nan, 0.0, 0.0), 0, 1, 1, 0.0), "half a pose"),
        (pack(Pose(0.0, math.inf, 0.0, 0.0), 0, 1, 1, 0.0), "pose out of range"),
        (pack(Pose(-0.1, 0.0, 0.0, 0.0), 0, 1, 1, 0.0), "time out of range"),
        (pack(Pose(0.1, 0.0, 0.0, 0.0, -1.0), 0, 1, 1, 0.0), "age out of range"),
        (pack(WheelCommand(0.0, 0.0, 0.0, 0, 7, 4), 0, 1, 1, 0.0), "unknown state of rest"),
        (pack(Clock(1, 0.0, 1.0, Stage.OVER, 0, (1,), rest=(9,)), 0, 1, 1, 0.0), "unknown state of rest"),
        (pack(Order(reason="smoke"), 0, 1, 1, 0.0)[:-1], "too short"),
        (pack(Order(), 0, 1, 1, 0.0)[:-1] + b"\x02\xff\xff", "reason is no text"),
        (pack(Order(reason="\x1b[2J"), 0, 1, 1, 0.0), "reason does not print"),
        (pack(Order(), 0, 1, 1, 0.0)[:-1] + b"\xff" + b"x" * 255, "reason too long"),
        (pack(WheelCommand(0.0, math.nan, 0.0, 0), 0, 1, 1, 0.0), "wheel speed out of range"),
        (pack(WheelCommand(0.0, 0.0, math.inf, 0), 0, 1, 1, 0.0), "wheel speed out of range"),
        (pack(WheelCommand(0.0, 0.0, 0.0, 2), 0, 1, 1, 0.0), "gripper out of range"),
        (pack(WheelCommand(-2.0, 0.0, 0.0, 0), 0, 1, 1, 0.0), "time out of range"),
        (pack(Deposit(0, 0, 0, 4, False, 0, False, 0), 0, 1, 1, 0.0), "direction out of range"),
        (pack(Deposit(0, 0, 0, 0, False, 7, False, 0), 0, 1, 1, 0.0), "unknown mode"),
        (pack(Reading(0, 0, 0.0, np.full(4, 1.5, np.float32)), 0, 1, 1, 0.0), "pheromone out of range"),
        (pack(Reading(0, 0, 0.0, np.full(4, np.nan, np.float32)), 0, 1, 1, 0.0), "pheromone out of range"),
        (pack(Reading(0, 0, -1.0, np.zeros(4, np.float32)), 0, 1, 1, 0.0), "density out of range"),
        (pack(Reading(0, 9, 0.0, np.zeros(4, np.float32)), 0, 1, 1, 0.0), "too short"),
        (pack(Clock(1, 0.0, math.nan, Stage.OVER, 0, (1,)), 0, 1, 1, 0.0), "speed out of range"),
        (pack(Clock(1, 0.0, 1.0, 3, 0, (1,)), 0, 1, 1, 0.0), "unknown stage"),
        (pack(Clock(1, 0.0, 1.0, Stage.OVER, 0, ()), 0, 1, 1, 0.0), "number of robots out of range"),
    ],
)
def test_what_is_no_message_is_refused_and_why(data, reason):
    with pytest.raises(MessageError) as caught:
        unpack(data)
    assert str(caught.value) == reason


@given(st.binary(max_size=200), st.sampled_from(list(Kind)))
def test_whatever_stands_behind_a_header_is_a_message_or_refused(body, kind):
    data = changed(POSE, 3, kind)[:HEADER_BYTES] + body
    try:
        header, message = unpack(data)
    except MessageError:
        return
    assert header.kind == kind == message.kind
    # What has been taken is what was sent, but for the payload of a NaN.
    assert len(message.body()) == len(body)


@pytest.mark.parametrize("reason", ["é" * 80, "x" * 300, ""])
def test_a_long_reason_is_cut_between_characters(reason):
    _, order = unpack(pack(Order(reason=reason), 0, 1, 1, 0.0))
    assert reason.startswith(order.reason)
    assert len(order.reason.encode()) == min(len(reason.encode()), MOST_REASON)


def test_a_patch_holds_four_numbers_of_each_cell():
    assert [patch_numbers(radius) for radius in (0, 1, 2)] == [4, 36, 100]
