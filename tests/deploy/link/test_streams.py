"""A receiver believes one process, in order, and knows how old its word is, whatever the clocks show."""

import math

import pytest

from robosim.deploy.link.messages import Header, Kind
from robosim.deploy.link.streams import FOREIGN, OLDER, SAME, Stream


def header(sequence, sent, instance=7):
    return Header(Kind.POSE, 0, instance, sequence, sent)


@pytest.fixture
def stream():
    stream = Stream()
    stream.bind(7)
    return stream


def test_messages_are_taken_once_and_in_order(stream):
    said = [stream.admit(header(sequence, 0.0), 0.0) for sequence in (1, 2, 2, 5, 3, 5, 6)]
    assert said == ["", "", SAME, "", OLDER, SAME, ""]
    # 3 and 4 had not come when 5 did.
    assert stream.lost == 2


def test_only_one_process_is_believed_until_another_takes_its_place(stream):
    assert stream.admit(header(9, 0.0, instance=8), 0.0) == FOREIGN
    assert stream.age(0.0) == math.inf
    assert stream.admit(header(4, 0.0), 0.0) == ""
    stream.bind(7)
    assert stream.admit(header(4, 0.0), 0.0) == SAME
    stream.bind(8)
    assert stream.age(0.0) == math.inf
    assert stream.admit(header(1, 0.0, instance=8), 0.0) == ""
    assert Stream().admit(header(1, 0.0), 0.0) == FOREIGN


def test_age_counts_from_the_arrival_and_by_how_much_that_was_late(stream):
    ahead = 1000.0  # The sender's clock shows another time.
    stream.admit(header(1, ahead), 0.01)
    assert stream.age(0.01) == 0.0
    assert stream.age(0.31) == pytest.approx(0.3)
    stream.admit(header(2, ahead + 0.1), 0.41)  # 0.3 s later than the first one was.
    assert stream.age(0.41) == pytest.approx(0.3)
    assert stream.silent(0.41) == 0.0
    stream.admit(header(3, ahead + 0.4), 0.41)
    assert stream.age(0.41) == pytest.approx(0.0)


def test_clocks_that_drift_apart_do_not_make_messages_old(stream):
    drift = 1e-4  # Each second, the receiver's clock gains so much: 0.36 s in an hour.
    for second in range(3600):
        stream.admit(header(second + 1, float(second)), second * (1 + drift))
    assert 0.0 <= stream.age(3599 * (1 + drift)) < 0.01
