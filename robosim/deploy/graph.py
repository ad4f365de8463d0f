"""A policy as an ONNX graph: networks, normalisation, mask of blocked moves, and the choice of actions.

The graph computes what `robosim.control.network.Networks` does, step by step. Its weights are stored as in
the policy's folder, one copy of each network.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from robosim.control.network import LEAST_SQUARE, NetworkSpec, Weights
from robosim.control.retreat import CHANCE, FINE, Known, RetreatDecisions, known_for_retreats
from robosim.deploy.runtime import ACTIONS, DRAWS, OBSERVATION, RETREATS, RETREATS_LEFT, VALUES
from robosim.discretise.observation import STANDING, Columns, MoveGains

OPSET = 18
IR_VERSION = 10
"""Of ONNX's files; runtimes refuse those that are newer than they are."""
BATCH = "batch"
_LAST_AXIS, _LEAST = "last_axis", "least_square"
"""Constants of the normalisation."""


class _Nodes:
    """Nodes and constants of a graph as it grows; each node's result is known by a name."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def constant(self, name: str, array: NDArray[np.generic]) -> str:
        self.constants.append(numpy_helper.from_array(array, name))
        return name

    def whole(self, name: str, *numbers: int) -> str:
        return self.constant(name, np.array(numbers, np.int64))

    def add(self, kind: str, *inputs: str, result: str = "", **attributes: Any) -> str:
        name = result or f"{kind.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, inputs, [name], name, **attributes))
        return name


def policy_graph(spec: NetworkSpec, weights: Weights, columns: Columns, name: str) -> onnx.GraphProto:
    """Return the graph of a whole policy.

    Its input is `observation`, float32 [batch, robots, size], and where actions are drawn `draws`, float32
    [batch, robots], numbers in [0, 1) such as those of `robosim.control.network.draws`. Its outputs are
    `actions`, int64 [batch, robots], and `values`, float32, as `Networks.outputs` returns them. Where robots
    retreat, there are an input `retreats` and an output `retreats_left` besides, int64 [batch, robots]: 0 in
    the first decision of an episode, and from then on what the decision before put out. `weights` are of the
    shapes `spec.shapes`; `columns` are where an observation holds what is needed besides.
    """
    nodes = _Nodes()
    values = _forward(nodes, spec, weights, _arranged(nodes, spec))
    if spec.networks > 1 or (spec.input == "team" and not spec.joint):
        values = nodes.add("Transpose", values, perm=[1, 0, 2])
    if spec.mask and columns.gains is not None:
        nothing = nodes.constant("nothing", np.array(-np.inf, np.float32))
        nodes.add("Where", _blocked(nodes, spec, columns.gains), nothing, values, result=VALUES)
    else:
        nodes.add("Identity", values, result=VALUES)
    _choose(nodes, spec, columns)
    robots: int | str = "robots" if spec.shared else spec.robots
    rows: tuple[int | str, ...] = (BATCH,) if spec.joint else (BATCH, robots)
    memory = [] if spec.retreat_in_place is None else [RETREATS, RETREATS_LEFT]
    make = helper.make_tensor_value_info
    return helper.make_graph(
        nodes.nodes,
        name,
        [
            make(OBSERVATION, TensorProto.FLOAT, (BATCH, robots, spec.observation)),
            *([] if spec.temperature is None else [make(DRAWS, TensorProto.FLOAT, (BATCH, robots))]),
            *(make(name, TensorProto.INT64, (BATCH, robots)) for name in memory[:1]),
        ],
        [
            make(ACTIONS, TensorProto.INT64, (BATCH, robots)),
            make(VALUES, TensorProto.FLOAT, (*rows, spec.outputs)),
            *(make(name, TensorProto.INT64, (BATCH, robots)) for name in memory[1:]),
        ],
        nodes.constants,
    )


def _arranged(nodes: _Nodes, spec: NetworkSpec) -> str:
    """Return the inputs of the first layer: rows of numbers, before them an axis of networks if several."""
    if spec.input == "team":
        shape = (-1, spec.inputs) if spec.joint else (1, -1, spec.inputs)
        return nodes.add("Reshape", OBSERVATION, nodes.whole("team", *shape))
    if spec.networks > 1:
        return nodes.add("Transpose", OBSERVATION, perm=[1, 0, 2])
    return OBSERVATION


def _forward(nodes: _Nodes, spec: NetworkSpec, weights: Weights, hidden: str) -> str:
    if spec.normalisation != "none":
        nodes.whole(_LAST_AXIS, -1)
        nodes.constant(_LEAST, np.array(LEAST_SQUARE, np.float32))
    for layer in range(len(spec.layers)):
        weight, bias = _parameters(nodes, spec, weights, layer)
        hidden = nodes.add("Add", nodes.add("MatMul", hidden, weight), bias)
        if layer == len(spec.layers) - 1:
            break
        if spec.normalisation == "layer":
            hidden = nodes.add("Sub", hidden, _mean(nodes, hidden))
            hidden = _over_size(nodes, hidden)
        hidden = nodes.add("Relu" if spec.activation == "relu" else "Tanh", hidden)
        if spec.normalisation == "rms":
            hidden = _over_size(nodes, hidden)
    return hidden


def _parameters(nodes: _Nodes, spec: NetworkSpec, weights: Weights, layer: int) -> tuple[str, str]:
    """Return the weight and the bias of a layer, in float32, for each robot where they have their own."""
    several = spec.networks > 1
    names = []
    for what in ("weight", "bias"):
        name = f"layer{layer}.{what}"
        array = weights[name]
        if what == "bias" and several:
            array = array[:, None]
        made = nodes.constant(name, array if several else array[0])
        if spec.precision == "float16":
            made = nodes.add("Cast", made, to=TensorProto.FLOAT)
        if several and spec.of_robot != tuple(range(spec.networks)):
            of_robot = nodes.whole(f"of_robot.{name}", *spec.of_robot)
            made = nodes.add("Gather", made, of_robot, axis=0)
        names.append(made)
    return names[0], names[1]


def _mean(nodes: _Nodes, hidden: str) -> str:
    return nodes.add("ReduceMean", hidden, _LAST_AXIS, keepdims=1)


def _over_size(nodes: _Nodes, hidden: str) -> str:
    """Divide each row by its root mean square, a little enlarged."""
    square = _mean(nodes, nodes.add("Mul", hidden, hidden))
    return nodes.add("Div", hidden, nodes.add("Sqrt", nodes.add("Add", square, _LEAST)))


def _blocked(nodes: _Nodes, spec: NetworkSpec, gains: MoveGains) -> str:
    """Return which outputs are not to be chosen, of the shape of `values`."""
    moves = np.arange(spec.actions) < gains.moves
    # Actions that are no moves read any column; below they are never blocked.
    _, _, lost = _gained(nodes, gains, np.where(moves, np.arange(spec.actions), 0))
    blocked = nodes.add("And", lost, nodes.constant("moves", moves))
    return _combined(nodes, spec, blocked) if spec.joint else blocked


def _gained(
    nodes: _Nodes, gains: MoveGains, moves: NDArray[np.int64], prefix: str = ""
) -> tuple[str, str, str]:
    """Return what `moves` gain toward home and toward the source, and which of them are blocked."""
    gained, lost = [], []
    for goal, start in (("home", gains.home), ("source", gains.source)):
        columns = nodes.whole(f"{prefix}gain_{goal}", *map(int, start + moves))
        gained.append(nodes.add("Gather", OBSERVATION, columns, axis=2))
        all_lost = nodes.constant(f"{prefix}cell_from_{goal}", np.array(-1.0, np.float32))
        lost.append(nodes.add("LessOrEqual", gained[-1], all_lost))
    return gained[0], gained[1], nodes.add("And", *lost)


def _combined(nodes: _Nodes, spec: NetworkSpec, blocked: str) -> str:
    """Return which combinations hold a blocked action, [batch, actions ** robots]."""
    flat = nodes.whole("combinations", 0, -1)
    before, after = nodes.whole("one_before", 1), nodes.whole("one_after", 2)
    combined = ""
    for robot in range(spec.robots):
        index = nodes.constant(f"robot_{robot}", np.array(robot, np.int64))
        own = nodes.add("Gather", blocked, index, axis=1)
        if not combined:
            combined = own
            continue
        outer = nodes.add("Or", nodes.add("Unsqueeze", combined, after), nodes.add("Unsqueeze", own, before))
        combined = nodes.add("Reshape", outer, flat)
    return combined


def _choose(nodes: _Nodes, spec: NetworkSpec, columns: Columns) -> None:
    """Choose the largest value, the first among equals as numpy does; or draw an action."""
    if spec.temperature is not None:
        _draw_action(nodes, spec, columns)
        return
    result = "combination" if spec.joint else ACTIONS
    chosen = nodes.add("ArgMax", VALUES, result=result, axis=-1, keepdims=0, select_last_index=0)
    if spec.joint:
        places = [spec.actions ** (spec.robots - 1 - robot) for robot in range(spec.robots)]
        whole = nodes.add("Unsqueeze", chosen, nodes.whole("robots_axis", 1))
        digits = nodes.add("Div", whole, nodes.whole("places", *places))
        nodes.add("Mod", digits, nodes.whole("base", spec.actions), result=ACTIONS)


def _draw_action(nodes: _Nodes, spec: NetworkSpec, columns: Columns) -> None:
    """Draw as robots do that move, and do what the spec says of those that stand."""
    last = nodes.whole("actions_axis", -1)
    temperature = nodes.constant("temperature", np.array(spec.temperature, np.float32))
    stands = ""
    if columns.in_place is not None and spec.asks_for_standing is not None:
        number = nodes.add("Gather", OBSERVATION, nodes.whole("in_place", columns.in_place), axis=2)
        least = nodes.constant("standing", np.array(STANDING, np.float32))
        stands = nodes.add("GreaterOrEqual", number, least)
    if spec.temperature_in_place is not None:
        other = nodes.constant("temperature_in_place", np.array(spec.temperature_in_place, np.float32))
        temperature = nodes.add("Where", stands, other, temperature)
    known = known_for_retreats(columns)
    if spec.retreats is None or known is None:
        _draw(nodes, last, temperature, ACTIONS)
        return
    drawn = _draw(nodes, last, temperature, "drawn")
    _retreat(nodes, spec.retreats, known, last, nodes.add("Squeeze", stands, last), drawn)


def _retreat(
    nodes: _Nodes, decisions: RetreatDecisions, known: Known, last: str, stands: str, otherwise: str
) -> None:
    """Replace the actions of robots that retreat, as `robosim.control.retreat.Retreat` does."""
    number = nodes.add("Gather", OBSERVATION, nodes.whole("laden", known.laden), axis=2)
    laden = nodes.add("GreaterOrEqual", number, nodes.constant("half", np.array(0.5, np.float32)))
    # Who begins to: by the last digits of the draw.
    fine = nodes.add("Mul", DRAWS, nodes.constant("fine", np.array(FINE, np.float32)))
    behind = nodes.add("Sub", fine, nodes.add("Floor", fine))
    would = nodes.add("Less", behind, nodes.constant("chance", np.array(CHANCE, np.float32)))
    none = nodes.constant("none", np.array(0, np.int64))
    begins = nodes.add("And", nodes.add("And", stands, would), nodes.add("Equal", RETREATS, none))
    length = nodes.add(
        "Where",
        nodes.add("Squeeze", laden, last),
        nodes.constant("laden_decisions", np.array(decisions.with_pellet, np.int64)),
        nodes.constant("decisions", np.array(decisions.without_pellet, np.int64)),
    )
    left = nodes.add("Where", begins, length, RETREATS)
    retreats = nodes.add("Greater", left, none)
    less = nodes.add("Sub", left, nodes.constant("one_less", np.array(1, np.int64)))
    nodes.add("Where", retreats, less, left, result=RETREATS_LEFT)
    # The open move that leads away from the goal the most.
    home, source, blocked = _gained(nodes, known.gains, np.arange(known.gains.moves), "retreat_")
    away = nodes.add("Where", laden, source, home)
    nowhere = nodes.constant("nowhere", np.array(-np.inf, np.float32))
    best = nodes.add(
        *("ArgMax", nodes.add("Where", blocked, nowhere, away)), axis=-1, keepdims=0, select_last_index=0
    )
    closed = nodes.add("ReduceMin", nodes.add("Cast", blocked, to=TensorProto.INT64), last, keepdims=0)
    acts = nodes.add("And", retreats, nodes.add("Equal", closed, none))
    nodes.add("Where", acts, best, otherwise, result=ACTIONS)


def _draw(nodes: _Nodes, last: str, divisor: str, result: str) -> str:
    """Draw actions as `robosim.control.network.drawn_actions` does."""
    above = nodes.add("Sub", VALUES, nodes.add("ReduceMax", VALUES, last, keepdims=1))
    weights = nodes.add("Exp", nodes.add("Div", above, divisor))
    sums = nodes.add("CumSum", weights, nodes.constant("summed_axis", np.array(-1, np.int64)))
    total = nodes.add("Slice", sums, last, nodes.whole("end", np.iinfo(np.int64).max), last)
    wanted = nodes.add("Mul", nodes.add("Unsqueeze", DRAWS, last), total)
    passed = nodes.add("Cast", nodes.add("LessOrEqual", sums, wanted), to=TensorProto.INT64)
    return nodes.add("ReduceSum", passed, last, result=result, keepdims=0)
