from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robosim.control.network import Networks, NetworkSpec, drawn_actions, draws
from robosim.control.retreat import Known, Retreat, RetreatDecisions
from robosim.discretise.observation import Columns, MoveGains
from robosim.errors import InputError, shown

MOVES = MoveGains(0, 4, 4)


def weights_of(spec, seed=0, scale=1.0):
    rng = np.random.default_rng(seed)
    return {
        name: (scale * rng.normal(size=shape)).astype(spec.precision) for name, shape in spec.shapes.items()
    }


def plain_network(spec, weights, network, numbers):
    """One network on one list of numbers, in float64."""
    values = np.asarray(numbers, float)
    for layer in range(len(spec.layers)):
        weight, bias = weights[f"layer{layer}.weight"][network], weights[f"layer{layer}.bias"][network]
        values = np.array([values @ column + b for column, b in zip(weight.T, bias, strict=True)], float)
        if layer < len(spec.layers) - 1:
            if spec.normalisation == "layer":
                values = (values - values.mean()) / np.sqrt(values.var() + 1e-5)
            values = np.maximum(values, 0) if spec.activation == "relu" else np.tanh(values)
            if spec.normalisation == "rms":
                values = values / np.sqrt((values**2).mean() + 1e-5)
    return values


kinds = st.sampled_from([("own", "action values"), ("own", "logits"), ("team", "logits")])


@settings(deadline=None, max_examples=60)
@given(
    kind=kinds,
    robots=st.integers(1, 4),
    groups=st.integers(1, 4),
    activation=st.sampled_from(["relu", "tanh"]),
    normalisation=st.sampled_from(["none", "rms", "layer"]),
    precision=st.sampled_from(["float32", "float16"]),
    batch=st.sampled_from([(), (1,), (3,), (2, 2)]),
    hidden=st.lists(st.integers(1, 6), min_size=1, max_size=3),
)
def test_outputs_are_those_of_each_robots_own_network(
    kind, robots, groups, activation, normalisation, precision, batch, hidden
):
    given_out = [robot % min(groups, robots) for robot in range(robots)]
    spec = NetworkSpec(
        input=kind[0],
        inputs=3 * (robots if kind[0] == "team" else 1),
        hidden=hidden,
        activation=activation,
        normalisation=normalisation,
        output=kind[1],
        actions=4,
        of_robot=list(range(robots)) if kind[0] == "team" else given_out,
        precision=precision,
    )
    weights = weights_of(spec)
    observation = np.random.default_rng(1).uniform(-1, 1, (*batch, robots, 3)).astype(np.float32)
    networks = Networks(spec, weights)
    outputs = networks.outputs(observation)
    assert outputs.dtype == np.float32
    assert outputs.shape == (*batch, robots, 4)
    assert (networks.act(observation) == outputs.argmax(axis=-1)).all()
    for place in np.ndindex((*batch, robots)):
        numbers = observation[place[:-1]].ravel() if spec.input == "team" else observation[place]
        plain = plain_network(spec, weights, spec.of_robot[place[-1]], numbers)
        np.testing.assert_allclose(outputs[place], plain, rtol=1e-3, atol=1e-3)


def joint_spec(robots, mask=False, size=8, output="joint action values"):
    return NetworkSpec(
        input="team",
        inputs=robots * size,
        hidden=(16,),
        output=output,
        mask=mask,
        of_robot=(0,) * robots,
    )


@pytest.mark.parametrize("output", ["joint action values", "joint logits"])
@pytest.mark.parametrize("mask", [False, True])
@pytest.mark.parametrize("robots", [1, 2, 3])
def test_joint_outputs_are_decoded_with_the_first_robot_as_the_most_significant_digit(robots, mask, output):
    spec = joint_spec(robots, mask, output=output)
    rng = np.random.default_rng(robots)
    weights = weights_of(spec)
    observation = rng.uniform(-0.99, 1, (40, robots, 8)).astype(np.float32)
    observation[rng.random(observation.shape) < 0.5] = -1.0
    networks = Networks(spec, weights, Columns(MOVES if mask else None))
    outputs, chosen = networks.outputs(observation), networks.act(observation)
    assert outputs.shape == (40, 5**robots)
    assert chosen.shape == (40, robots)
    assert chosen.dtype == np.int64
    for env in range(40):
        values = plain_network(spec, weights, 0, observation[env].ravel())
        best = None
        for number, actions in enumerate(product(range(5), repeat=robots)):
            blocked = mask and any(
                move < 4 and observation[env, robot, move] == observation[env, robot, 4 + move] == -1
                for robot, move in enumerate(actions)
            )
            assert np.isneginf(outputs[env, number]) == blocked
            if not blocked:
                assert outputs[env, number] == pytest.approx(values[number], rel=1e-3, abs=1e-3)
                if best is None or outputs[env, number] > outputs[env, best[0]]:
                    best = number, actions
        assert tuple(chosen[env]) == best[1]


def test_blocked_moves_are_not_chosen_by_single_robots():
    spec = NetworkSpec(inputs=8, hidden=(16,), mask=True, of_robot=(0, 1))
    free = spec.changed(mask=False)
    weights = weights_of(spec)
    rng = np.random.default_rng(0)
    observation = rng.uniform(-0.99, 1.0, (200, 2, 8)).astype(np.float32)
    observation[rng.random(observation.shape) < 0.6] = -1.0
    blocked = (observation[..., :4] == -1) & (observation[..., 4:] == -1)
    blocked = np.concatenate([blocked, np.zeros((200, 2, 1), bool)], axis=2)
    masked, unmasked = (Networks(one, weights, Columns(MOVES)) for one in (spec, free))
    assert (masked.outputs(observation) == np.where(blocked, -np.inf, unmasked.outputs(observation))).all()
    taken = np.take_along_axis(blocked, masked.act(observation)[..., None], axis=2)
    assert blocked.any()
    assert not taken.any()
    with pytest.raises(InputError) as caught:
        Networks(spec, weights)
    assert str(caught.value) == (
        f"mask is {shown(True)}, but must be {shown(False)} where observations hold no gains of moves."
    )


def test_one_network_for_all_drives_any_number_of_robots():
    spec = NetworkSpec(inputs=6, of_robot=(0, 0))
    networks = Networks(spec, weights_of(spec))
    observation = np.random.default_rng(3).uniform(-1, 1, (5, 9, 6)).astype(np.float32)
    apart = [networks.outputs(observation[:, [robot]]) for robot in range(9)]
    np.testing.assert_allclose(networks.outputs(observation), np.concatenate(apart, axis=1), rtol=1e-5)
    assert spec.shared
    assert not spec.changed(of_robot=(0, 1)).shared
    assert not joint_spec(2).shared


def test_figures_of_a_spec():
    spec = NetworkSpec(inputs=7, hidden=[4, 3], of_robot=[1, 0, 1, 1])
    assert (spec.robots, spec.networks, spec.observation, spec.outputs) == (4, 2, 7, 5)
    assert spec.layers == ((7, 4), (4, 3), (3, 5))
    assert spec.numbers == 8 * 4 + 5 * 3 + 4 * 5
    assert spec.shapes == {
        "layer0.weight": (2, 7, 4),
        "layer0.bias": (2, 4),
        "layer1.weight": (2, 4, 3),
        "layer1.bias": (2, 3),
        "layer2.weight": (2, 3, 5),
        "layer2.bias": (2, 5),
    }
    joint = joint_spec(3)
    assert (joint.observation, joint.outputs, joint.layers[-1]) == (8, 125, (16, 125))


JOINT = {"output": "joint action values"}


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"of_robot": [0, 2]}, "of_robot is [0, 2], but must name every stored network, counted from 0."),
        (
            {"of_robot": []},
            "of_robot is [], but must be a list of 1 to 1000 whole numbers from 0 to 999.",
        ),
        (
            JOINT,
            (
                'output is "joint action values" with input "own" and 1 networks, '
                'but must come from one network with input "team".'
            ),
        ),
        (
            {"output": "joint logits", "of_robot": [0, 1], "input": "team", "inputs": 8},
            (
                'output is "joint logits" with input "team" and 2 networks, '
                'but must come from one network with input "team".'
            ),
        ),
        (
            JOINT | {"input": "team", "of_robot": [0] * 9, "inputs": 9},
            (
                'output is "joint action values" of 9 robots with 5 actions, '
                "but must have at most 1000000 combinations."
            ),
        ),
        (
            JOINT | {"input": "team", "of_robot": [0] * 1000, "inputs": 1000},
            (
                'output is "joint action values" of 1000 robots with 5 actions, '
                "but must have at most 1000000 combinations."
            ),
        ),
        (
            {"input": "team"},
            (
                "of_robot is [0, 0], but must name a network of its own for each robot "
                'where input is "team": robots that share one would all do the same.'
            ),
        ),
        (
            {"input": "team", "of_robot": [0, 1]},
            'inputs is 7, but must be a multiple of 2, the number of robots, where input is "team".',
        ),
        ({"mask": True, "actions": 4}, f"actions is 4, but must be at least 5 where mask is {shown(True)}."),
        (
            {"input": "team", "of_robot": [0], "inputs": 4, "output": "joint logits", "temperature": 0.5},
            'temperature is 0.5, but must be absent where output is "joint logits".',
        ),
        (
            {"temperature_in_place": 2.0},
            "temperature_in_place is 2.0, but must be absent where temperature is.",
        ),
        ({"retreat_in_place": 8}, "retreat_in_place is 8, but must be absent where temperature is."),
        (
            {"temperature": 0.5, "retreat_in_place": 2},
            "retreat_in_place is 2, but must be a whole number from 3 to 10000 or None.",
        ),
        (
            {"temperature": 0.5, "retreat_with_pellet": 8},
            "retreat_with_pellet is 8, but must be absent where retreat_in_place is.",
        ),
        (
            {"temperature": 0.5, "retreat_in_place": 8, "retreat_with_pellet": 0},
            "retreat_with_pellet is 0, but must be a whole number from 1 to 10000 or None.",
        ),
        ({"temperature": 0.0}, "temperature is 0.0, but must be a number from 0.001 to 1000 or None."),
        ({"activation": "gelu"}, 'activation is "gelu", but must be "relu" or "tanh".'),
        ({"hidden": [4097]}, "hidden is 4097, but must be a list of 1 to 8 whole numbers from 1 to 4096."),
    ],
)
def test_what_makes_no_sense_is_refused_in_a_sentence(fields, sentence):
    with pytest.raises(InputError) as caught:
        NetworkSpec(**({"inputs": 7, "of_robot": [0, 0]} | fields))
    assert str(caught.value) == sentence


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda w: w.pop("layer1.bias"), 'weights: tensor "layer1.bias" is missing.'),
        (lambda w: w.update(x=np.zeros(1)), 'weights: tensor "x" is too many; the card has 2 layers.'),
        (
            lambda w: w.update({"layer0.bias": np.zeros((2, 3), np.float32)}),
            "weights: the shape of layer0.bias is [2, 3], but must be [1, 3].",
        ),
        (
            lambda w: w.update({"layer0.bias": np.zeros((1, 3), np.float16)}),
            "weights: layer0.bias is of type float16, but must be float32.",
        ),
        (
            lambda w: w.update({"layer0.bias": np.full((1, 3), np.inf, np.float32)}),
            "weights: layer0.bias holds a number that is not finite.",
        ),
    ],
)
def test_weights_that_do_not_fit_are_refused(change, sentence):
    spec = NetworkSpec(inputs=2, hidden=(3,), of_robot=(0,))
    weights = weights_of(spec)
    change(weights)
    with pytest.raises(InputError) as caught:
        Networks(spec, weights)
    assert str(caught.value) == sentence


@settings(deadline=None, max_examples=100)
@given(
    exponent=st.floats(0, 38),
    activation=st.sampled_from(["relu", "tanh"]),
    normalisation=st.sampled_from(["none", "rms", "layer"]),
    seed=st.integers(0, 100),
)
def test_what_is_accepted_never_overflows(exponent, activation, normalisation, seed):
    spec = NetworkSpec(
        inputs=4, hidden=(8, 8), activation=activation, normalisation=normalisation, of_robot=(0, 1)
    )
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(0, exponent, len(spec.shapes))
    weights = {
        name: np.clip(array * one, -3e38, 3e38).astype(np.float32)
        for (name, array), one in zip(weights_of(spec, seed).items(), scale, strict=True)
    }
    try:
        networks = Networks(spec, weights)
    except InputError as error:
        assert str(error).startswith("weights: numbers in layer")
        return
    observation = rng.choice(np.array([-1, 0, 1], np.float32), (200, 2, 4))
    with np.errstate(over="raise", invalid="raise"):
        assert np.isfinite(networks.outputs(observation)).all()


def test_weights_that_overflow_are_refused_with_the_layer_and_the_bound():
    spec = NetworkSpec(inputs=2, hidden=(1,), of_robot=(0,))
    weights = {name: np.full(shape, 2e19, np.float32) for name, shape in spec.shapes.items()}
    with pytest.raises(InputError) as caught:
        Networks(spec, weights)
    assert str(caught.value) == (
        "weights: numbers in layer1 may reach 1.2e+39, but must stay below 3.4e+38, or they overflow."
    )


def plain_draw(decision, env, robot):
    """SplitMix64 on whole numbers without a limit, cut to 64 bits by hand."""

    def mixed(state):
        state = (state + 0x9E3779B97F4A7C15) % 2**64
        state = (state ^ (state >> 30)) * 0xBF58476D1CE4E5B9 % 2**64
        state = (state ^ (state >> 27)) * 0x94D049BB133111EB % 2**64
        return state ^ (state >> 31)

    return (mixed(mixed(mixed(decision) ^ env) ^ robot) >> 40) / 2**24


@settings(deadline=None, max_examples=50)
@given(decision=st.integers(0, 2**40), envs=st.integers(1, 3), robots=st.integers(1, 4))
def test_draws_follow_from_the_numbers_of_decision_environment_and_robot(decision, envs, robots):
    drawn = draws(decision, (envs, robots))
    assert drawn.tolist() == [[plain_draw(decision, e, r) for r in range(robots)] for e in range(envs)]
    assert (draws(decision, (robots,)) == drawn[0]).all()


def test_draws_are_spread_evenly_and_tell_nothing_of_each_other():
    drawn = np.stack([draws(decision, (20, 10)) for decision in range(500)])
    counts = np.histogram(drawn, bins=50, range=(0.0, 1.0))[0]
    assert abs(counts - drawn.size / 50).max() < 6 * (drawn.size / 50) ** 0.5
    for axis in range(3):
        one, next_one = np.delete(drawn, -1, axis), np.delete(drawn, 0, axis)
        assert abs(np.corrcoef(one.ravel(), next_one.ravel())[0, 1]) < 0.015


def test_actions_are_drawn_with_the_probabilities_of_the_softmax():
    values = np.array([1.0, -np.inf, 0.3, 2.0, -np.inf], np.float32)
    count = 40_000
    drawn = np.arange(count, dtype=np.float32) / np.float32(count)
    chosen = drawn_actions(np.tile(values, (count, 1)), 0.5, drawn)
    weights = [np.exp(value / 0.5) for value in values.tolist()]
    shares = np.bincount(chosen, minlength=5) / count
    assert shares == pytest.approx(np.array(weights) / sum(weights), abs=2 / count)


@given(
    values=st.lists(st.floats(-50, 50, width=32) | st.just(-np.inf), min_size=2, max_size=9),
    temperature=st.sampled_from([0.001, 0.5, 1000.0]),
    drawn=st.sampled_from([0.0, 0.25, 1.0 - 2.0**-24]),
)
def test_what_is_blocked_is_never_drawn(values, temperature, drawn):
    values[0] = 0.0 if max(values) == -np.inf else values[0]
    chosen = drawn_actions(np.array([values], np.float32), temperature, np.array([drawn], np.float32))
    assert values[int(chosen[0])] > -np.inf


def test_a_low_temperature_chooses_the_best_and_any_needs_the_number_of_the_decision():
    spec = NetworkSpec(inputs=4, hidden=[8], of_robot=[0, 0, 0])
    weights = weights_of(spec)
    observation = np.random.default_rng(1).normal(size=(50, 3, 4)).astype(np.float32)
    best = Networks(spec, weights).act(observation)
    cold = Networks(spec.changed(temperature=0.001), weights)
    assert (cold.act(observation, 7) == best).mean() > 0.95
    warm = Networks(spec.changed(temperature=5.0), weights)
    assert (warm.act(observation, 7) == warm.act(observation, 7)).all()
    assert (warm.act(observation, 7) != warm.act(observation, 8)).any()
    with pytest.raises(InputError) as caught:
        warm.act(observation)
    assert str(caught.value) == (
        "decision is missing, but must be the number of the decision in the episode: "
        "these networks draw their actions."
    )
    for decision in (1.5, -1, 2**64, "x", True):
        with pytest.raises(InputError, match="^decision is .*, but must be a whole number from 0 to"):
            warm.act(observation, decision)


def test_a_robot_that_has_stood_for_a_while_draws_at_the_temperature_for_that():
    spec = NetworkSpec(inputs=4, hidden=[8], of_robot=[0, 0, 0], temperature=0.05)
    weights = weights_of(spec)
    observation = np.random.default_rng(1).normal(size=(300, 3, 4)).astype(np.float32)
    observation[..., 2] = np.random.default_rng(2).choice([0.0, 0.45, 0.5, 0.95], (300, 3))
    stands = observation[..., 2] >= 0.5
    both = Networks(spec.changed(temperature_in_place=5.0), weights, Columns(in_place=2)).act(observation, 7)
    moving = Networks(spec, weights).act(observation, 7)
    standing = Networks(spec.changed(temperature=5.0), weights).act(observation, 7)
    assert (both == np.where(stands, standing, moving)).all()
    assert (standing != moving)[stands].any()
    with pytest.raises(InputError) as caught:
        Networks(spec.changed(temperature_in_place=5.0), weights)
    assert str(caught.value) == (
        "temperature_in_place is 5.0, but must be absent where observations do not say how long a robot has "
        "been in place."
    )


@pytest.mark.parametrize(
    ("with_pellet", "decisions"), [(None, RetreatDecisions(6, 2)), (5, RetreatDecisions(6, 5))]
)
def test_robots_that_retreat_do_and_the_others_draw(with_pellet, decisions):
    retreating = {"retreat_in_place": 6, "retreat_with_pellet": with_pellet}
    spec = NetworkSpec(inputs=10, hidden=[8], of_robot=[0, 0, 0], temperature=1.0, **retreating)
    weights, columns = weights_of(spec), Columns(MOVES, 8, 9)
    observation = np.random.default_rng(1).uniform(-0.9, 0.9, (300, 3, 10)).astype(np.float32)
    team, left = Networks(spec, weights, columns), np.zeros((300, 3), np.int64)
    plain = Networks(spec.changed(**dict.fromkeys(retreating)), weights)
    for decision in range(10):
        drawn, before = plain.act(observation, decision), left.copy()
        expected = Retreat(Known(*columns), decisions)(drawn, observation, draws(decision, (300, 3)), before)
        assert (team.act(observation, decision, left) == expected).all()
        assert (left == before).all()
        assert (expected != drawn).any()
    for wrong, what in (
        (None, "missing"),
        (left[:, :2], "of type int64 and shape (300, 2)"),
        (left.astype(np.int32), "of type int32 and shape (300, 3)"),
    ):
        with pytest.raises(InputError) as caught:
            team.act(observation, 3, wrong)
        assert str(caught.value) == (
            f"retreats is {what}, but must be an array of int64 and shape (300, 3): these robots retreat, "
            "and it holds for how many decisions yet."
        )


@pytest.mark.parametrize(
    ("columns", "missing"),
    [
        (Columns(MOVES, None, 9), "say how long a robot has been in place"),
        (Columns(None, 8, 9), "say what robots carry and which moves lead where"),
        (Columns(MOVES, 8, None), "say what robots carry and which moves lead where"),
    ],
)
def test_robots_retreat_only_where_they_observe_what_they_go_by(columns, missing):
    spec = NetworkSpec(inputs=10, hidden=[8], of_robot=[0], temperature=1.0, retreat_in_place=6)
    with pytest.raises(InputError) as caught:
        Networks(spec, weights_of(spec), columns)
    assert str(caught.value) == (
        f"retreat_in_place is 6, but must be absent where observations do not {missing}."
    )
