import numpy as np
import pytest
import torch

from robosim.learning.networks import Activations, Backward, NetworkShape, Parameters, forward, initialise

SHAPE = NetworkShape(robots=3, inputs=7, hidden=(16, 12), outputs=5)


def fresh(shape=SHAPE, seed=0):
    parameters = Parameters(shape)
    initialise(parameters, np.random.SeedSequence(seed).spawn(shape.robots))
    return parameters


def modules(parameters):
    """The same networks, one torch.nn.Sequential a robot."""
    networks = []
    for robot in range(parameters.shape.robots):
        layers = []
        for weight, bias in zip(parameters.weights, parameters.biases, strict=True):
            linear = torch.nn.Linear(weight.shape[1], weight.shape[2])
            with torch.no_grad():
                linear.weight.copy_(weight[robot].T)
                linear.bias.copy_(bias[robot, 0])
            layers += [linear, torch.nn.ReLU()]
        networks.append(torch.nn.Sequential(*layers[:-1]))
    return networks


def test_forward_equals_one_network_after_another():
    parameters = fresh()
    inputs = torch.randn(3, 10, 7, generator=torch.Generator().manual_seed(0))
    values = forward(parameters, inputs, Activations(SHAPE, 10))
    for robot, network in enumerate(modules(parameters)):
        torch.testing.assert_close(values[robot], network(inputs[robot]))


def test_hand_written_gradient_equals_autograd():
    parameters = fresh()
    generator = torch.Generator().manual_seed(1)
    inputs = torch.randn(3, 10, 7, generator=generator)
    delta = torch.randn(3, 10, 5, generator=generator)
    activations, backward = Activations(SHAPE, 10), Backward(SHAPE, 10)
    forward(parameters, inputs, activations)
    backward(parameters, inputs, activations.outputs, delta.clone())
    for robot, network in enumerate(modules(parameters)):
        network(inputs[robot]).backward(delta[robot])
        linears = [layer for layer in network if isinstance(layer, torch.nn.Linear)]
        for layer, linear in enumerate(linears):
            torch.testing.assert_close(backward.gradient.weights[layer][robot], linear.weight.grad.T)
            torch.testing.assert_close(backward.gradient.biases[layer][robot, 0], linear.bias.grad)


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
