"""That what is restored goes on as what was saved, for tests of any algorithm."""

import json

import numpy as np

from robosim.learning.algorithms.protocol import LargeMemory, State
from tests.learning.rollouts import one_by_one, rollout


def check_that_a_restored_one_goes_on_in_the_same_bits(whole, rest, decisions, more=9):
    """`rest` restores what `whole` saves after so many decisions, then both act and learn alike.

    The facts go through JSON and a large memory comes in two parts, as in a checkpoint.
    """
    seen = one_by_one(rollout(1, decisions + more, robots=len(whole.actors().spec.of_robot)))

    def take(algorithms, decision):
        acted = [one.act(decision.observation, 0.5) for one in algorithms]
        figures = [one.update(0.5) for one in algorithms]
        for one in algorithms:
            one.observe(decision._replace(action=acted[0]))
        np.testing.assert_array_equal(acted[0], acted[-1])
        np.testing.assert_equal(figures[0], figures[-1])

    for decision in seen[:decisions]:
        take([whole], decision)
    tensors, facts = whole.state()
    rest.restore(State(tensors, json.loads(json.dumps(facts))))
    if isinstance(whole, LargeMemory):
        first, last = whole.held()
        middle = (first + last) // 2
        rest.recall(first, [whole.export(first, middle), whole.export(middle, last)] if first < last else [])
    before = whole.actors().weights
    for decision in seen[decisions:]:
        take([whole, rest], decision)
    after, again = whole.actors().weights, rest.actors().weights
    for name, array in after.items():
        np.testing.assert_array_equal(array, again[name])
        assert not np.array_equal(array, before[name])
    saved, tensors = whole.state().tensors, rest.state().tensors
    assert saved.keys() == tensors.keys()
    for name, tensor in saved.items():
        np.testing.assert_array_equal(tensor.numpy(), tensors[name].numpy(), name)
