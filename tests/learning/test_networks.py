import dataclasses

import numpy as np
import pytest
import torch

from robosim.errors import InputError
from robosim.learning.networks import (
    Activations,
    NetworkShape,
    Parameters,
    backward,
    forward,
    initialise,
    transposed,
)
from tests.learning.plain import plain_networks

SHAPE = NetworkShape(robots=3, inputs=7, hidden=(16, 12), outputs=5)


def fresh(shape=SHAPE, seed=0):
    parameters = Parameters(shape)
    initialise(parameters, np.random.SeedSequence(seed).spawn(shape.robots))
    return parameters


@pytest.mark.parametrize("normalised", [False, True])
def test_forward_equals_one_network_after_another(normalised):
    shape = dataclasses.replace(SHAPE, normalised=normalised)
    parameters = fresh(shape)
    inputs = torch.randn(3, 10, 7, generator=torch.Generator().manual_seed(0))
    for keep in (True, False):
        values = forward(parameters, inputs, Activations(shape, 10, keep=keep))
        for robot, network in enumerate(plain_networks(parameters)):
            torch.testing.assert_close(values[robot], network(inputs[robot]))


@pytest.mark.parametrize("normalised", [False, True])
@pytest.mark.parametrize("hidden", [(), (16,), (16, 12, 9)])
def test_hand_written_gradient_equals_autograd(hidden, normalised):
    shape = NetworkShape(robots=3, inputs=7, hidden=hidden, outputs=5, normalised=normalised)
    parameters, gradient = fresh(shape), Parameters(shape)
    generator = torch.Generator().manual_seed(1)
    inputs = torch.randn(3, 10, 7, generator=generator)
    delta = transposed(3, 10, 5).copy_(torch.randn(3, 10, 5, generator=generator))
    activations, scratch = Activations(shape, 10), Activations(shape, 10, keep=False)
    forward(parameters, inputs, activations)
    backward(parameters, inputs, activations, delta, scratch.hidden, gradient)
    for robot, network in enumerate(plain_networks(parameters)):
        network(inputs[robot]).backward(delta[robot])
        linears = [layer for layer in network if isinstance(layer, torch.nn.Linear)]
        for layer, linear in enumerate(linears):
            torch.testing.assert_close(gradient.weights[layer][robot], linear.weight.grad.T)
            torch.testing.assert_close(gradient.biases[layer][robot, 0], linear.bias.grad)


def test_parameters_are_views_of_one_buffer_that_they_fill():
    parameters = Parameters(SHAPE)
    for number, tensor in enumerate((*parameters.weights, *parameters.biases), start=1):
        tensor.fill_(number)
    assert (parameters.flat > 0).all()
    assert parameters.flat.numel() == SHAPE.parameters == 3 * (7 * 16 + 16 + 16 * 12 + 12 + 12 * 5 + 5)


def test_initial_parameters_are_spread_as_in_torch_linear():
    shape = NetworkShape(robots=4, inputs=100, hidden=(128,), outputs=5)
    parameters = fresh(shape)
    torch.manual_seed(0)
    linear = torch.nn.Linear(100, 128)
    for robot in range(4):
        for ours, theirs in ((parameters.weights[0], linear.weight), (parameters.biases[0], linear.bias)):
            assert ours[robot].abs().max() <= 0.1
            assert float(ours[robot].std()) == pytest.approx(float(theirs.detach().std()), rel=0.2)
    assert not torch.equal(parameters.weights[0][0], parameters.weights[0][1])


def test_a_robots_initial_network_does_not_depend_on_the_team():
    alone = fresh(NetworkShape(1, 7, (16, 12), 5))
    team = fresh(SHAPE)
    for one, many in zip(alone.weights + alone.biases, team.weights + team.biases, strict=True):
        assert torch.equal(one[0], many[0])


def test_loaded_parameters_come_back_and_leave_other_robots_alone():
    few = fresh(NetworkShape(2, 7, (16, 12), 5), seed=1)
    many, before = fresh(), fresh()
    many.load(few.to_numpy(), first_robot=1)
    for name, loaded in many.to_numpy().items():
        assert (loaded[1:] == few.to_numpy()[name]).all()
        assert (loaded[:1] == before.to_numpy()[name][:1]).all()


def test_parameters_that_do_not_fit_are_refused_and_nothing_is_loaded():
    parameters, before = fresh(), fresh()
    good = fresh(seed=1).to_numpy()
    wrong = good | {"layer1.bias": np.zeros((3, 13), np.float32)}
    with pytest.raises(InputError, match=r"layer1.bias has the shape \(3, 13\): \(3, 12\) is needed"):
        parameters.load(wrong)
    with pytest.raises(InputError, match=r"\(3, 7, 16\) is needed, for robots 1 to 3 of 3"):
        parameters.load(good, first_robot=1)
    with pytest.raises(InputError, match=r"layer0.weight has the shape \(\)"):
        parameters.load(good | {"layer0.weight": np.float32(1.0)})
    with pytest.raises(InputError, match="arrays are layer0.weight: they must be layer0.weight, layer0.bias"):
        parameters.load({"layer0.weight": good["layer0.weight"]})
    assert torch.equal(parameters.flat, before.flat)
