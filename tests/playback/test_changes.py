import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from robosim.playback.changes import changed_rows


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
