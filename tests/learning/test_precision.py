from dataclasses import replace

import numpy as np
import pytest
import torch

from robosim.errors import InputError
from robosim.learning.networks import NetworkShape
from robosim.learning.precision import _products, products_in, require_precision, rounds_to_bfloat16
from tests.learning.algorithms.dqn.test_learner import SETTINGS, SHAPE, filled
from tests.learning.products import PROCESSORS, one_that_rounds

WIDE = replace(SHAPE, hidden=(64, 64))
BATCH = replace(SETTINGS, batch_size=32)


@pytest.fixture(autouse=True)
def found_out_anew():
    yield
    rounds_to_bfloat16.cache_clear()


@pytest.mark.parametrize("precision", ["float16", "double"])
def test_an_unknown_precision_is_refused(precision):
    with pytest.raises(InputError) as caught:
        filled(precision=precision)
    assert str(caught.value) == f'precision is "{precision}", but must be float32 or bfloat16.'


@pytest.mark.parametrize("processor", PROCESSORS)
@pytest.mark.parametrize(
    "shape",
    [WIDE, SHAPE, NetworkShape(8, 90, (128, 128, 128), 5), NetworkShape(1, 300, (), 5)],
    ids=["small", "tiny", "team", "linear"],
)
def test_bfloat16_is_offered_just_where_some_product_of_random_numbers_is_rounded(
    monkeypatch, processor, shape
):
    known = processor(monkeypatch)
    generator, found = torch.Generator().manual_seed(0), []
    for left, right in _products(shape, 32, torch.device("cpu")):
        for operand in (left, right):
            operand.copy_(torch.randn(operand.shape, generator=generator))
        with products_in("bfloat16"):
            made = torch.bmm(left, right, out=torch.empty(len(left), left.shape[1], right.shape[2])).double()
        exact = torch.bmm(left.double(), right.double(), out=torch.empty_like(made))
        halves = left.bfloat16().double(), right.bfloat16().double()
        rounded = torch.bmm(*halves, out=torch.empty_like(made))
        found.append(bool((made - rounded).norm() < 0.1 * (made - exact).norm()))
    offered = rounds_to_bfloat16(shape, 32)
    assert offered == any(found)
    assert known is None or offered == known


@pytest.mark.parametrize("processor", PROCESSORS)
def test_bfloat16_updates_are_near_those_of_float32_and_equal_from_run_to_run_or_refused(
    monkeypatch, processor
):
    processor(monkeypatch)
    if not rounds_to_bfloat16(WIDE, BATCH.batch_size):
        with pytest.raises(InputError) as caught:
            filled(WIDE, BATCH, precision="bfloat16")
        assert str(caught.value) == (
            'precision is "bfloat16", but must be float32 here: on this machine, torch rounds no product of '
            "an update of this size to bfloat16."
        )
        return
    exact, half, again = (
        filled(WIDE, BATCH, precision=precision) for precision in ("float32", "bfloat16", "bfloat16")
    )
    start = exact.parameters.flat.clone()
    for _ in range(20):
        for learner in (exact, half, again):
            learner.update(1e-3)
    assert torch.equal(half.parameters.flat, again.parameters.flat)
    assert not torch.equal(half.parameters.flat, exact.parameters.flat)
    moved = (exact.parameters.flat - start).norm()
    assert (half.parameters.flat - exact.parameters.flat).norm() < 0.2 * moved
    np.testing.assert_allclose(half.loss(), exact.loss(), rtol=0.05)


def test_the_products_looked_at_are_those_of_an_update(monkeypatch):
    seen, bmm = set(), torch.bmm

    def noted(left, right, out):
        seen.add((left.shape, left.stride(), right.shape, right.stride()))
        return bmm(left, right, out=out)

    learner = filled(WIDE, BATCH)
    monkeypatch.setattr(torch, "bmm", noted)
    learner.update(1e-3)
    made, seen = seen, set()
    rounds_to_bfloat16.cache_clear()
    monkeypatch.setattr(torch, "bmm", bmm)
    probed = {
        (left.shape, left.stride(), right.shape, right.stride())
        for left, right in _products(WIDE, BATCH.batch_size, torch.device("cpu"))
    }
    assert {(left, right) for left, _, right, _ in made} == {(left, right) for left, _, right, _ in probed}
    # The draws from the replay lie apart: an observation beside its successor.
    order = [
        {(np.argsort(a).tolist()[0], np.argsort(b).tolist()[0]) for _, a, _, b in some}
        for some in (made, probed)
    ]
    assert order[0] == order[1]


def test_an_update_leaves_the_precision_of_products_to_others(monkeypatch):
    one_that_rounds(monkeypatch)
    before = torch.get_float32_matmul_precision()
    require_precision("bfloat16", WIDE, 32)
    filled(WIDE, BATCH, precision="bfloat16").update(1e-3)
    assert torch.get_float32_matmul_precision() == before
