import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from robosim.learning.algorithms.qmix.mixer import MonotonicMixer, SumMixer


def mixer(seed=0, robots=3, size=4, scale=1.0):
    made = MonotonicMixer(robots, size, 8, 16, np.random.SeedSequence(seed))
    with torch.no_grad():
        for parameter in made.parameters():
            parameter.mul_(scale)
    return made


def plain(made, values, state):
    """The mixer as in the paper, for one team at one moment, in numpy."""
    layers = {name: one.detach().double().numpy() for name, one in made.named_parameters()}
    state = (state - state.mean()) / np.sqrt(state.var() + 1e-5)

    def network(name):
        hidden = np.maximum(layers[f"{name}.0.weight"] @ state + layers[f"{name}.0.bias"], 0)
        return layers[f"{name}.2.weight"] @ hidden + layers[f"{name}.2.bias"]

    first = np.abs(network("weight_in")).reshape(len(values), -1)
    hidden = values @ first + layers["bias_in.weight"] @ state + layers["bias_in.bias"]
    hidden = np.where(hidden > 0, hidden, np.exp(np.minimum(hidden, 0)) - 1)
    return hidden @ np.abs(network("weight_out")) + network("bias_out")[0]


def test_it_computes_what_the_paper_says():
    made, rng = mixer(), np.random.default_rng(0)
    values, state = rng.normal(size=(3, 20)), rng.normal(size=(20, 4))
    with torch.no_grad():
        mixed = made(torch.from_numpy(values).float(), torch.from_numpy(state).float())
    for row in range(20):
        np.testing.assert_allclose(mixed[row], plain(made, values[:, row], state[row]), rtol=1e-4, atol=1e-5)


@settings(max_examples=50, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    robots=st.integers(1, 5),
    scale=st.floats(0.1, 10.0),
    rise=st.floats(0.0, 100.0),
    data=st.data(),
)
def test_the_team_s_value_never_falls_as_a_robot_s_value_grows(seed, robots, scale, rise, data):
    made, rng = mixer(seed, robots, scale=scale).double(), np.random.default_rng(seed)
    values, state = (
        torch.from_numpy(rng.normal(size=(robots, 10))),
        torch.from_numpy(rng.normal(size=(10, 4))),
    )
    more = values.clone()
    more[data.draw(st.integers(0, robots - 1))] += rise
    with torch.no_grad():
        before, after = made(values, state), made(more, state)
    assert (after >= before - 1e-9 * (1 + before.abs())).all()


def test_the_value_of_states_far_beyond_all_others_does_not_grow():
    made, rng = mixer(), np.random.default_rng(0)
    values = torch.from_numpy(rng.normal(size=(3, 20))).float()
    state = torch.from_numpy(rng.normal(size=(20, 4))).float()
    with torch.no_grad():
        near, far = made(values, state), made(values, 1e4 * state)
    np.testing.assert_allclose(far, near, rtol=1e-3, atol=1e-3)


def test_a_sum_is_a_sum():
    values = torch.from_numpy(np.random.default_rng(0).normal(size=(3, 5)))
    np.testing.assert_allclose(SumMixer()(values, torch.zeros(5, 2)), sum(row.numpy() for row in values))


def test_equal_seeds_make_equal_mixers_and_leave_torch_s_generator_alone():
    before = torch.get_rng_state()
    first, again, other = mixer(1), mixer(1), mixer(2)
    assert torch.equal(torch.get_rng_state(), before)
    for one, two, three in zip(*(made.parameters() for made in (first, again, other)), strict=True):
        assert torch.equal(one, two)
        assert not torch.equal(one, three)
