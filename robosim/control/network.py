"""The networks of a policy: what they are (`NetworkSpec`), and the one numpy code that runs them all."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from robosim.control.retreat import Retreat, RetreatDecisions, checked_retreats, known_for_retreats
from robosim.discretise.observation import NO_COLUMNS, Columns, blocked_moves, standing
from robosim.errors import InputError, shown, whole_number
from robosim.records import Many, Record
from robosim.robot.drivers import FEWEST_ACTIONS

LEAST_SQUARE = 1e-5
"""Added to the mean square, or to the variance, by which hidden layers are normalised."""
Activation = Literal["relu", "tanh"]
Normalisation = Literal["none", "rms", "layer"]
_NEEDED = {
    "temperature_in_place": "temperature",
    "retreat_in_place": "temperature",
    "retreat_with_pellet": "retreat_in_place",
}
IN_PLACE_FIELDS = tuple(_NEEDED)
"""Fields of `NetworkSpec` that say what robots do that have stood for a while; each needs another one."""
DRAWING = ("temperature", *IN_PLACE_FIELDS)
"""Fields of `NetworkSpec` that say how actions are drawn."""
PELLET_SHARE = 3
"""By this the decisions of a retreat are divided for a robot with a pellet, where nothing else is said."""
MOST_DECISIONS = 2**64 - 1
"""Up to which draws count the decisions of an episode."""
MOST_OUTPUTS = 1_000_000
"""Of a network that chooses for all robots: five actions of eight robots have 390,625 combinations."""

Output = Literal["action values", "logits", "joint action values", "joint logits"]
Floats = NDArray[np.float32]
Whole = NDArray[np.int64]
Weights = Mapping[str, NDArray[np.floating]]
"""`layer0.weight` [networks, in, out], `layer0.bias` [networks, out], `layer1.weight` and so on."""

_DTYPES = (np.dtype("<f4"), np.dtype("<f2"))


class NetworkSpec(Record):
    """What the networks of a team compute, and which of them each robot runs."""

    input: Literal["own", "team"] = "own"
    """What goes in: a robot's own observation, or those of all robots one after another."""
    inputs: int = Field(ge=1, le=100_000)
    """Numbers that go in."""
    hidden: Many[Annotated[int, Field(ge=1, le=4096)]] = Field(
        default=(128, 128, 128), min_length=1, max_length=8
    )
    """Widths of the hidden layers."""
    activation: Activation = "relu"
    """Of the hidden layers."""
    normalisation: Normalisation = "none"
    """`rms`: a hidden layer is divided by its root mean square, after the activation (Zhang 2019). `layer`:
    it is brought to mean 0 and variance 1 before the activation (Ba 2016). Neither has learned gains or
    biases: the next layer's weights can do most of what those would."""
    mask: bool = False
    """Blocked moves are not chosen (`robosim.discretise.observation.blocked_moves`)."""
    output: Output = "action values"
    """What comes out, of which the largest is chosen: a number for each action of a robot, or (`joint`) one
    for each combination of the actions of all robots. Combination c is written in digits to base `actions`,
    robot 0's action first: c = (a_0 * actions + a_1) * actions + a_2 and so on."""
    actions: int = Field(default=FEWEST_ACTIONS, ge=2, le=100)
    """Of a robot."""
    of_robot: Many[Annotated[int, Field(ge=0, le=999)]] = Field(min_length=1, max_length=1000)
    """[robots] which of the stored networks each robot runs."""
    precision: Literal["float32", "float16"] = "float32"
    """Of the weights as stored; they are computed with in float32."""
    temperature: float | None = Field(default=None, ge=0.001, le=1000)
    """Actions are drawn, with the probabilities softmax(outputs / temperature), so that robots that stand in
    each other's way do not do the same for ever; none for the action of the largest output, every time."""
    temperature_in_place: float | None = Field(default=None, ge=0.001, le=1000)
    """Instead of `temperature`, for a robot that has stood for a while: of which the number `in place` of its
    observation is `STANDING` or more. Robots that have come to a stand try something else; none for the same
    temperature at all times."""
    retreat_in_place: int | None = Field(default=None, ge=3, le=10_000)
    """Decisions for which a robot that has stood for a while retreats once it begins to
    (`robosim.control.retreat`); none for no retreats."""
    retreat_with_pellet: int | None = Field(default=None, ge=1, le=10_000)
    """The same with a pellet; none for a third of `retreat_in_place`."""

    @property
    def robots(self) -> int:
        """Robots in the team that learned."""
        return len(self.of_robot)

    @property
    def networks(self) -> int:
        """Networks that are stored."""
        return max(self.of_robot) + 1

    @property
    def joint(self) -> bool:
        """Whether one network chooses for all robots."""
        return self.output in ("joint action values", "joint logits")

    @property
    def asks_for_standing(self) -> str | None:
        """Field that needs an observation to say how long a robot has been in place; None where none does."""
        return next((name for name in IN_PLACE_FIELDS if getattr(self, name) is not None), None)

    @property
    def retreats(self) -> RetreatDecisions | None:
        """Decisions for which robots retreat; None where they do not."""
        if self.retreat_in_place is None:
            return None
        with_pellet = self.retreat_with_pellet
        if with_pellet is None:
            with_pellet = self.retreat_in_place // PELLET_SHARE
        return RetreatDecisions(self.retreat_in_place, with_pellet)

    @property
    def shared(self) -> bool:
        """Whether each robot runs the same network by itself; it then drives a team of any size."""
        return self.networks == 1 and self.input == "own"

    @property
    def observation(self) -> int:
        """Numbers in a robot's observation."""
        return self.inputs // self.robots if self.input == "team" else self.inputs

    @property
    def outputs(self) -> int:
        """Numbers that a network puts out."""
        return int(self.actions**self.robots) if self.joint else self.actions

    @property
    def layers(self) -> tuple[tuple[int, int], ...]:
        """(inputs, outputs) of each layer of a network."""
        return tuple(pairwise((self.inputs, *self.hidden, self.outputs)))

    @property
    def numbers(self) -> int:
        """Weights and biases of one network."""
        return sum((inputs + 1) * outputs for inputs, outputs in self.layers)

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each array of the weights, by its name."""
        shapes: dict[str, tuple[int, ...]] = {}
        for layer, (inputs, outputs) in enumerate(self.layers):
            shapes[f"layer{layer}.weight"] = (self.networks, inputs, outputs)
            shapes[f"layer{layer}.bias"] = (self.networks, outputs)
        return shapes

    @model_validator(mode="after")
    def _check_networks(self) -> Self:
        if set(self.of_robot) != set(range(self.networks)):
            raise ValueError(
                f"of_robot is {shown(self.of_robot)}, but must name every stored network, counted from 0"
            )
        if self.joint and (self.input != "team" or self.networks != 1):
            raise ValueError(
                f'output is {shown(self.output)} with input "{self.input}" and {self.networks} networks, '
                'but must come from one network with input "team"'
            )
        if self.joint and self.robots * np.log(self.actions) > np.log(MOST_OUTPUTS):
            raise ValueError(
                f"output is {shown(self.output)} of {self.robots} robots with {self.actions} actions, but "
                f"must have at most {MOST_OUTPUTS} combinations"
            )
        if self.input == "team" and not self.joint and self.networks != self.robots:
            raise ValueError(
                f"of_robot is {shown(self.of_robot)}, but must name a network of its own for each robot "
                'where input is "team": robots that share one would all do the same'
            )
        if self.input == "team" and self.inputs % self.robots:
            raise ValueError(
                f"inputs is {self.inputs}, but must be a multiple of {self.robots}, the number of robots, "
                'where input is "team"'
            )
        if self.joint and self.temperature is not None:
            raise ValueError(
                f"temperature is {shown(self.temperature)}, but must be absent where output is "
                f"{shown(self.output)}"
            )
        check_drawing(self)
        if self.mask and self.actions < FEWEST_ACTIONS:
            raise ValueError(
                f"actions is {self.actions}, but must be at least {FEWEST_ACTIONS} "
                f"where mask is {shown(True)}"
            )
        return self


def check_drawing(settings: Record) -> None:
    """Raise ValueError where one of the fields `DRAWING` is given without the one that it needs."""
    for name, needed in _NEEDED.items():
        if getattr(settings, needed) is None and (given := getattr(settings, name)) is not None:
            raise ValueError(f"{name} is {shown(given)}, but must be absent where {needed} is")


def unmet_standing(spec: NetworkSpec, columns: Columns) -> str | None:
    """Return which field of `spec` asks for what observations do not hold, as a sentence without its end."""
    field = spec.asks_for_standing
    missing = "" if columns.in_place is not None else "say how long a robot has been in place"
    if spec.retreat_in_place is not None and not missing and known_for_retreats(columns) is None:
        field, missing = "retreat_in_place", "say what robots carry and which moves lead where"
    if field is None or not missing:
        return None
    return f"{field} is {shown(getattr(spec, field))}, but must be absent where observations do not {missing}"


class Networks:
    """The networks of a team, in numpy: from the observations of all robots to the actions of all robots."""

    def __init__(
        self,
        spec: NetworkSpec,
        weights: Weights,
        columns: Columns = NO_COLUMNS,
        place: str = "weights",
    ) -> None:
        """Take `weights` of the shapes `spec.shapes`.

        `columns` are where an observation holds what is needed besides: a spec with a `mask` needs the gains
        of moves, `temperature_in_place` how long a robot has been in place, `retreat_in_place` all of them.
        InputError, in one sentence that begins with `place`, for weights that do not fit or overflow.
        """
        check_weights(spec, weights, place)
        if spec.mask and columns.gains is None:
            raise InputError(
                f"mask is {shown(True)}, but must be {shown(False)} where observations hold no "
                "gains of moves."
            )
        if (unmet := unmet_standing(spec, columns)) is not None:
            raise InputError(f"{unmet}.")
        self.spec = spec
        self._in_place = columns.in_place
        self._gains = columns.gains if spec.mask else None
        known, decisions = known_for_retreats(columns), spec.retreats
        self._retreat = Retreat(known, decisions) if known and decisions is not None else None
        # Rounded weights are widened once, here: products of float16 are slow and coarse on a CPU.
        wide = {name: np.asarray(weights[name], np.float32) for name in spec.shapes}
        if spec.networks > 1:
            wide = {name: array[list(spec.of_robot)] for name, array in wide.items()}
        layers = range(len(spec.layers))
        self._weights = [np.ascontiguousarray(wide[f"layer{layer}.weight"]) for layer in layers]
        self._biases = [wide[f"layer{layer}.bias"][:, None] for layer in layers]

    def outputs(self, observation: Floats) -> Floats:
        """Return what the networks put out, in float32, for `observation` [..., robots, size].

        It is [..., robots, actions], or [..., actions ** robots] where the output is joint. With a mask, what
        is blocked is minus infinity: a blocked move, and a combination in which any robot's move is.
        """
        spec, batch = self.spec, observation.shape[:-2]
        if spec.input == "team":
            hidden = observation.reshape(1, -1, spec.inputs)
        else:
            hidden = observation.reshape(-1, *observation.shape[-2:]).swapaxes(0, 1)
        values = self._forward(np.ascontiguousarray(hidden)).swapaxes(0, 1)
        values = values.reshape(*batch, *values.shape[1 + spec.joint :])
        if self._gains is not None:
            blocked = np.asarray(blocked_moves(observation, self._gains), np.bool_)
            if spec.joint:
                values[blocked_combinations(blocked, spec.actions)] = -np.inf
            else:
                values[..., : blocked.shape[-1]][blocked] = -np.inf
        return values

    def act(
        self, observation: Floats, decision: int | None = None, retreats: Whole | None = None
    ) -> NDArray[np.int64]:
        """Return the action of every robot, [..., robots], for `observation` [..., robots, size].

        The one of the largest output; the lowest index among equals. With a temperature, one that is drawn:
        which, depends on the number of the `decision` since the episode began, besides the observation.
        Robots that retreat do so for a while: `retreats`, int64 [..., robots], holds for how many decisions
        yet. It is all 0 when an episode begins, and is changed in place. InputError where the number or the
        array is needed, and missing or none.
        """
        values = self.outputs(observation)
        if self.spec.temperature is not None:
            if decision is None:
                raise InputError(
                    "decision is missing, but must be the number of the decision in the episode: "
                    "these networks draw their actions."
                )
            number = whole_number("decision", decision, 0, MOST_DECISIONS)
            return self._drawn(values, observation, number, retreats)
        chosen: NDArray[np.int64] = values.argmax(axis=-1)
        if not self.spec.joint:
            return chosen
        return np.stack(np.unravel_index(chosen, (self.spec.actions,) * self.spec.robots), axis=-1)

    def _drawn(
        self, values: Floats, observation: Floats, number: int, retreats: Whole | None
    ) -> NDArray[np.int64]:
        """Return the actions [..., robots] that robots draw in the decision `number`, or retreat by."""
        spec, drawn = self.spec, draws(number, values.shape[:-1])
        temperature = np.asarray(spec.temperature, np.float32)
        if spec.temperature_in_place is not None and self._in_place is not None:
            stands = standing(observation, self._in_place)
            temperature = np.where(stands, np.float32(spec.temperature_in_place), temperature)
        actions = drawn_actions(values, temperature, drawn)
        if self._retreat is None:
            return actions
        return self._retreat(actions, observation, drawn, checked_retreats(retreats, actions.shape))

    def _forward(self, hidden: Floats) -> Floats:
        """Return [networks, batch, outputs] of inputs [networks, batch, inputs]; one network serves all."""
        for weight, bias in zip(self._weights[:-1], self._biases[:-1], strict=True):
            hidden = hidden @ weight
            hidden += bias
            if self.spec.normalisation == "layer":
                hidden -= np.mean(hidden, axis=-1, keepdims=True)
                hidden /= _size(hidden)
            if self.spec.activation == "relu":
                np.maximum(hidden, 0.0, out=hidden)
            else:
                np.tanh(hidden, out=hidden)
            if self.spec.normalisation == "rms":
                hidden /= _size(hidden)
        return hidden @ self._weights[-1] + self._biases[-1]


def draws(decision: int, shape: tuple[int, ...]) -> Floats:
    """Return numbers spread evenly over [0, 1) for the robots `shape` [..., robots] in a decision.

    Each follows from the numbers of the decision, the environment and the robot alone (SplitMix64, Steele
    2014), so that whoever counts decisions draws the same: an evaluation, a robot, somebody else's program.
    They are multiples of 2^-24, which float32 holds exactly.
    """
    state = _mixed(np.array([decision], np.uint64))
    environments = np.arange(int(np.prod(shape[:-1])), dtype=np.uint64)
    state = _mixed(state ^ environments)[:, None]
    state = _mixed(state ^ np.arange(shape[-1], dtype=np.uint64))
    whole = (state >> np.uint64(40)).astype(np.float32)
    return (whole * np.float32(2.0**-24)).reshape(shape)


def _mixed(state: NDArray[np.uint64]) -> NDArray[np.uint64]:
    state = state + np.uint64(0x9E3779B97F4A7C15)
    state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return state ^ (state >> np.uint64(31))


def drawn_actions(values: Floats, temperature: float | Floats, drawn: Floats) -> NDArray[np.int64]:
    """Return actions [..., robots] of probability softmax(values / temperature), by numbers from `draws`.

    `values` are [..., robots, actions]; a `temperature` is one for all robots, or [..., robots]. A value of
    minus infinity is never chosen, unless all are.
    """
    best = values.max(axis=-1, keepdims=True)
    weights = np.exp((values - best) / np.asarray(temperature, np.float32)[..., None])
    sums = np.cumsum(weights, axis=-1)
    # A draw is below 1, so the sum of all is never reached, and what adds nothing to it is never chosen.
    chosen: NDArray[np.int64] = (sums <= drawn[..., None] * sums[..., -1:]).sum(axis=-1)
    return chosen


def _size(hidden: Floats) -> Floats:
    """Return the root mean square of each row of `hidden` [..., width], a little enlarged, [..., 1]."""
    size: Floats = np.sqrt(np.mean(hidden * hidden, axis=-1, keepdims=True) + np.float32(LEAST_SQUARE))
    return size


def blocked_combinations(blocked: NDArray[np.bool_], actions: int) -> NDArray[np.bool_]:
    """Return which combinations [..., actions ** robots] hold a `blocked` move [..., robots, moves]."""
    still = np.zeros((*blocked.shape[:-1], actions - blocked.shape[-1]), np.bool_)
    each = np.concatenate((blocked, still), axis=-1)
    combined = each[..., 0, :]
    for robot in range(1, each.shape[-2]):
        both = combined[..., :, None] | each[..., robot, None, :]
        combined = both.reshape(*both.shape[:-2], -1)
    return combined


def check_weights(spec: NetworkSpec, weights: Weights, place: str) -> None:
    """Raise InputError, in one sentence that begins with `place`, for weights that cannot serve `spec`."""
    shapes = spec.shapes
    for name in sorted(shapes.keys() | weights.keys()):
        if name not in weights:
            raise InputError(f"{place}: tensor {shown(name)} is missing.")
        if name not in shapes:
            raise InputError(
                f"{place}: tensor {shown(name)} is too many; the card has {len(spec.layers)} layers."
            )
        array = weights[name]
        if array.shape != shapes[name]:
            raise InputError(
                f"{place}: the shape of {name} is {shown(array.shape)}, but must be {shown(shapes[name])}."
            )
        if array.dtype not in _DTYPES or array.dtype.name != spec.precision:
            raise InputError(f"{place}: {name} is of type {array.dtype}, but must be {spec.precision}.")
        if not np.isfinite(array).all():
            raise InputError(f"{place}: {name} holds a number that is not finite.")
    _check_overflow(spec, weights, place)


def _check_overflow(spec: NetworkSpec, weights: Weights, place: str) -> None:
    """Raise InputError for weights, finite each, that overflow together for observations in -1 to 1."""
    most = float(np.finfo(np.float32).max)
    bound = 1.0
    for layer, (_, outputs) in enumerate(spec.layers):
        last = layer == len(spec.layers) - 1
        largest = bound * np.abs(weights[f"layer{layer}.weight"]).sum(axis=1, dtype=np.float64)
        bound = float((largest + np.abs(weights[f"layer{layer}.bias"])).max())
        tanh = spec.activation == "tanh" and not last
        layer_norm, rms = (spec.normalisation == name and not last for name in ("layer", "rms"))
        # Where layers are normalised, the sum of the squares of what goes in must be finite too; numbers less
        # their mean may be twice as large.
        squared = layer_norm or (rms and not tanh)
        limit = (most / outputs) ** 0.5 / (1 + layer_norm) if squared else most
        if bound > limit:
            raise InputError(
                f"{place}: numbers in layer{layer} may reach {bound:.1e}, but must stay below {limit:.1e}, "
                "or they overflow."
            )
        if rms or layer_norm or tanh:
            bound = 1.0 if tanh and not rms else outputs**0.5
