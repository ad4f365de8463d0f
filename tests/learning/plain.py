"""What the stacked networks are, written with torch's own modules, for tests to compare with."""

import torch


class Normalised(torch.nn.Module):
    """Each row over its root mean square."""

    def forward(self, rows):
        return rows / (rows.square().mean(dim=-1, keepdim=True) + 1e-5).sqrt()


def plain_networks(parameters):
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
            layers += [Normalised()] if parameters.shape.normalised else []
        rest = 2 if parameters.shape.normalised else 1
        networks.append(torch.nn.Sequential(*layers[:-rest]))
    return networks
