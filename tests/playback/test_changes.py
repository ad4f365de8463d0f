import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from robosim.playback.changes import changed_rows, onsets


@given(
    arrays(np.int64, st.tuples(st.integers(1, 12), st.integers(1, 3)), elements=st.integers(0, 1)),
    st.integers(0, 12),
)
def test_changed_rows_of_chunks_are_those_of_the_whole(values, cut):
    whole = [row == 0 or (values[row] != values[row - 1]).any() for row in range(len(values))]
    assert changed_rows(values, None).tolist() == whole
    cut = min(cut, len(values) - 1)
    if cut > 0:
        second = changed_rows(values[cut:], values[cut - 1])
        assert changed_rows(values[:cut], None).tolist() + second.tolist() == whole


@given(
    st.lists(st.tuples(st.integers(0, 2), st.integers(0, 40)), max_size=20).map(
        lambda events: sorted(events, key=lambda e: e[1])
    ),
    st.integers(0, 20),
)
def test_onsets_of_chunks_are_those_of_a_plain_loop(events, cut):
    expected, last = [], {}
    for pair, time in events:
        expected.append(pair not in last or time - last[pair] > 5)
        last[pair] = time
    pairs = np.array([pair for pair, _ in events], dtype=np.int64)
    times = np.array([float(time) for _, time in events])
    remembered: dict[int, float] = {}
    found = [
        opens
        for part in (slice(None, cut), slice(cut, None))
        for opens in onsets(pairs[part], times[part], remembered, 5.0).tolist()
    ]
    assert found == expected
    assert remembered == last
