import hashlib
import json
import os
import random

import numpy as np
import onnx
import pytest

from robosim.arena import load_arena
from robosim.cli.main import main
from robosim.control.card import PolicyCard
from robosim.control.environment import environment_for
from robosim.control.learned import LearnedController
from robosim.control.policy import find_policy, read_policy
from robosim.deploy.export import agreement, onnx_model, real_observations
from robosim.deploy.runtime import ACTIONS, OnnxPolicy
from robosim.errors import InputError
from tests.deploy.made import make_policy, random_observations

KINDS = {
    "one network for all": {"of_robot": (0, 0, 0)},
    "groups": {"of_robot": (1, 0, 1)},
    "one each": {"of_robot": (0, 1, 2), "output": "logits"},
    "team": {"of_robot": (0, 1, 2), "input": "team", "output": "logits"},
    "joint values": {"of_robot": (0, 0, 0), "input": "team", "output": "joint action values"},
    "joint logits": {"of_robot": (0, 0, 0), "input": "team", "output": "joint logits"},
}


@pytest.mark.parametrize("name", ["paper-8", "paper-4-smadrl", "paper-4-wheels"])
def test_onnxruntime_does_what_a_shipped_policy_does(name):
    folder = find_policy(name)
    policy = read_policy(folder)
    found = agreement(OnnxPolicy(onnx_model(folder, name)), policy, real_observations(policy, name, 240))
    assert found.holds, str(found)
    assert found.observations >= 240
    assert found.largest_value > 0.0


@pytest.mark.parametrize("mask", [False, True])
@pytest.mark.parametrize("normalisation", ["none", "rms", "layer"])
@pytest.mark.parametrize("kind", KINDS)
def test_onnxruntime_computes_every_kind_of_network(tmp_path, kind, normalisation, mask):
    activation = "tanh" if normalisation == "rms" else "relu"
    folder = make_policy(
        tmp_path / "made", normalisation=normalisation, mask=mask, activation=activation, **KINDS[kind]
    )
    policy = read_policy(folder)
    observations = random_observations(policy, 60)
    assert np.isneginf(policy.values(observations)).any() == mask
    found = agreement(OnnxPolicy(onnx_model(folder)), policy, observations)
    assert found.holds, str(found)


@pytest.mark.parametrize("kind", KINDS)
def test_a_team_of_one_is_a_team(tmp_path, kind):
    folder = make_policy(tmp_path / "made", robots=1, mask=True, **{**KINDS[kind], "of_robot": (0,)})
    policy = read_policy(folder)
    assert agreement(OnnxPolicy(onnx_model(folder)), policy, random_observations(policy, 60)).holds


@pytest.mark.parametrize("actions", ["wheels", "wheels-9"])
def test_moves_of_wheel_actions_are_masked(tmp_path, actions):
    folder = make_policy(tmp_path / "made", mask=True, env={"actions": actions}, of_robot=(0, 0, 0))
    policy = read_policy(folder)
    observations = random_observations(policy, 60)
    assert np.isneginf(policy.values(observations)).any(axis=(0, 1)).tolist() == [True] * 2 + [False] * (
        policy.card.network.actions - 2
    )
    assert agreement(OnnxPolicy(onnx_model(folder)), policy, observations).holds


@pytest.mark.parametrize("kind", KINDS)
def test_half_precision_is_widened_in_the_graph(tmp_path, kind):
    folder = make_policy(tmp_path / "made", precision="float16", **KINDS[kind])
    model = onnx_model(folder)
    stored = [one for one in onnx.load_from_string(model).graph.initializer if one.name.startswith("layer")]
    assert {one.data_type for one in stored} == {onnx.TensorProto.FLOAT16}
    policy = read_policy(folder)
    assert agreement(OnnxPolicy(model), policy, random_observations(policy, 60)).holds


@pytest.mark.parametrize("kind", KINDS)
def test_the_first_of_equal_values_is_chosen_as_numpy_does(tmp_path, kind):
    """Biases alone decide, of whole numbers with many equals, and the mask leaves some of them."""

    def tied(spec):
        weights = {name: np.zeros(shape, np.float32) for name, shape in spec.shapes.items()}
        last = f"layer{len(spec.layers) - 1}.bias"
        weights[last] = np.random.default_rng(3).integers(0, 2, spec.shapes[last]).astype(np.float32)
        return weights

    policy = read_policy(make_policy(tmp_path / "made", weights=tied, mask=True, **KINDS[kind]))
    observations = random_observations(policy, 200)
    values = policy.values(observations)
    best = (values == values.max(axis=-1, keepdims=True)).sum(axis=-1)
    assert (best > 1).mean() > 0.3
    found = agreement(OnnxPolicy(onnx_model(tmp_path / "made")), policy, observations)
    assert (found.other_actions, found.largest_difference) == (0, 0.0)


@pytest.mark.parametrize(("retreat", "with_pellet"), [(None, None), (8, None), (8, 6)])
@pytest.mark.parametrize("in_place", [None, 20.0])
@pytest.mark.parametrize("of_robot", [(0, 0, 0), (0, 1, 2)])
def test_actions_are_drawn_in_the_graph_as_in_numpy(tmp_path, of_robot, in_place, retreat, with_pellet):
    drawing = {
        "output": "logits",
        "temperature": 0.7,
        "temperature_in_place": in_place,
        "retreat_in_place": retreat,
        "retreat_with_pellet": with_pellet,
    }
    folder = make_policy(tmp_path / "made", mask=True, of_robot=of_robot, **drawing)
    policy, exported = read_policy(folder), OnnxPolicy(onnx_model(folder))
    observations = random_observations(policy, 400)
    best = policy.values(observations).argmax(axis=-1)
    stands = observations[..., policy.card.columns.in_place] >= 0.5
    left, expected_left = (None if retreat is None else np.zeros(best.shape, np.int64) for _ in "12")
    for decision in (0, 1, 2, 123_456):
        drawn = exported.act(observations, decision, left)
        assert (drawn == policy.act(observations, decision, expected_left)).all()
        assert 0.1 < (drawn != best).mean() < 0.9
        if in_place is not None:
            assert (drawn != best)[stands].mean() > (drawn != best)[~stands].mean() + 0.05
    if retreat is not None:
        assert (left == expected_left).all()
        assert 0.05 < (left > 0)[stands].mean() < 0.6
        assert not (left > 0)[~stands].any()
        for wrong, what in ((None, "missing"), (left[:1, :1], "of type int64 and shape (1, 1)")):
            with pytest.raises(InputError) as caught:
                exported.act(observations, 0, wrong)
            assert str(caught.value) == (
                f"model: retreats is {what}, but must be an array of int64 and shape (400, 3): these robots "
                "retreat, and it holds for how many decisions yet."
            )
    assert agreement(exported, policy, observations).holds
    with pytest.raises(InputError) as caught:
        exported.act(observations)
    assert str(caught.value) == (
        "model: decision is missing, but must be the number of the decision in the episode: "
        "this policy draws its actions."
    )


def test_disagreement_is_found(tmp_path):
    one = make_policy(tmp_path / "one", of_robot=(0, 0, 0))
    other = make_policy(tmp_path / "other", of_robot=(0, 0, 0), seed=1)
    masked = make_policy(tmp_path / "masked", of_robot=(0, 0, 0), mask=True)
    policy = read_policy(one)
    observations = random_observations(policy, 60)
    found = agreement(OnnxPolicy(onnx_model(other)), policy, observations)
    assert not found.holds
    assert 0 < found.other_actions < 180
    assert 0.1 < found.largest_difference < np.inf
    found = agreement(OnnxPolicy(onnx_model(masked)), policy, observations)
    assert not found.holds
    assert found.largest_difference == np.inf


def test_one_network_for_all_drives_a_team_of_any_size(tmp_path):
    policy = read_policy(make_policy(tmp_path / "made", of_robot=(0, 0, 0)))
    observations = random_observations(policy, 8).reshape(4, 6, -1)
    actions, values = OnnxPolicy(onnx_model(tmp_path / "made")).run(observations)
    assert (actions == policy.act(observations)).all()
    assert values.shape == (4, 6, 5)


def test_the_file_says_all_that_is_needed_to_run_it():
    folder = find_policy("paper-4")
    card = read_policy(folder).card
    said = OnnxPolicy(onnx_model(folder)).metadata
    assert PolicyCard.from_table(json.loads(said["card"]), "card") == card
    assert said["policy"] == "paper-4"
    assert said["weights_sha256"] == hashlib.sha256((folder / "policy.safetensors").read_bytes()).hexdigest()
    assert float(said["decision_period"]) == card.arena.timing.decision_period
    assert float(said["control_period"]) == card.arena.timing.control_period
    assert json.loads(said["actions"]) == ["north", "south", "west", "east", "stop"]
    robot = json.loads(said["robot"])
    assert robot["max_wheel_speed"] == card.arena.robot.max_wheel_speed
    assert robot["top_speed"] == pytest.approx(robot["max_wheel_speed"] * robot["wheel_radius"])
    mixed = read_policy(find_policy("relay-4")).card
    sheets = json.loads(OnnxPolicy(onnx_model(find_policy("relay-4"))).metadata["robot"])
    own = load_arena(mixed.env.arena).team(4).sheets
    assert [one["top_speed"] for one in sheets] == [sheet.top_speed for sheet in own]
    assert [one["wheel_base"] for one in sheets] == [sheet.wheel_base for sheet in own]
    numbers = json.loads(said["observation"])
    assert [number["name"] for number in numbers] == list(card.observation)
    # A number times its scale is what it measures: seen where a robot is known to be.
    env = environment_for(LearnedController(read_policy(folder), "paper-4"))
    seen = env.reset()[0, 0].astype(float) * [number["scale"] for number in numbers]
    named = dict(zip(card.observation, seen, strict=True))
    pose = env.world.state.pose[0, 0]
    assert [named["x"], named["y"]] == pytest.approx(pose[:2].tolist(), abs=1e-6)
    home, source = env.arena.distances.sample(pose[:2])
    assert named["distance to home"] == pytest.approx(home, abs=1e-6)
    assert named["distance to source"] == pytest.approx(source, abs=1e-6)
    within = pose[:2] - (np.floor(pose[:2] / env.arena.cell_size) + 0.5) * env.arena.cell_size
    assert [named["offset in cell x"], named["offset in cell y"]] == pytest.approx(within.tolist(), abs=1e-6)


def test_another_file_is_no_policy(tmp_path):
    path = tmp_path / "team.onnx"
    path.write_bytes(b"not a graph")
    with pytest.raises(InputError) as caught:
        OnnxPolicy(path)
    assert str(caught.value).startswith(f"{path}: onnxruntime cannot run it: ")
    assert "\n" not in str(caught.value)
    model = onnx.load_from_string(onnx_model(make_policy(tmp_path / "made", of_robot=(0, 0, 0))))
    del model.metadata_props[:]
    onnx.save(model, path)
    with pytest.raises(InputError) as caught:
        OnnxPolicy(path).card  # noqa: B018
    assert str(caught.value) == f"{path}: its metadata hold no card, so robosim has not exported it."


def test_equal_folders_give_equal_files(tmp_path):
    one = make_policy(tmp_path / "a" / "made", of_robot=(0, 1, 0), mask=True)
    other = make_policy(tmp_path / "b" / "made", of_robot=(0, 1, 0), mask=True)
    assert onnx_model(one) == onnx_model(other)


def test_the_command_writes_what_it_has_compared(tmp_path, capsys):
    path = tmp_path / "team.onnx"
    assert main(["export", "paper-2", "--onnx", str(path), "--observations", "50"]) == 0
    assert path.read_bytes() == onnx_model(find_policy("paper-2"))
    said = capsys.readouterr().out
    assert said.startswith(f"{path}: 0.2")
    assert "onnxruntime and robosim: the same actions on 64 observations" in said


def test_a_run_folder_is_exported_under_its_own_name(tmp_path):
    make_policy(tmp_path / "run-a" / "policy", of_robot=(0, 0, 0))
    path = tmp_path / "a.onnx"
    assert main(["export", str(tmp_path / "run-a"), "--onnx", str(path), "--observations", "1"]) == 0
    assert OnnxPolicy(path).metadata["policy"] == "run-a"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["paper-2"], "nothing to export to: give --onnx FILE.onnx or --robotarium FOLDER."),
        (
            ["paper-2", "--onnx", "team.bin"],
            "team.bin: cannot be written: the name of the file must end in .onnx.",
        ),
        (
            ["paper-2", "--onnx", "nowhere/team.onnx"],
            "nowhere/team.onnx: cannot be written: No such file or directory.",
        ),
        (
            ["lanes", "--onnx", "team.onnx"],
            "'lanes' is a scripted controller: it has no networks to export.",
        ),
        (
            ["paper-2-smadr", "--onnx", "team.onnx"],
            (
                "no policy is named 'paper-2-smadr', and there is no such folder: did you mean "
                "paper-2-smadrl or paper-8-smadrl or paper-4-smadrl?"
            ),
        ),
        (
            ["paper-2", "--onnx", "team.onnx", "--observations", "0"],
            "--observations is 0, but must be a whole number from 1 to 1000000.",
        ),
    ],
)
def test_what_cannot_be_exported_is_refused_in_a_sentence(tmp_path, monkeypatch, capsys, arguments, sentence):
    monkeypatch.chdir(tmp_path)
    assert main(["export", *arguments]) == 2
    assert capsys.readouterr().err == f"robosim: {sentence}\n"
    assert list(tmp_path.iterdir()) == []


def changed_graph(path, model, change):
    """Write a model after `change` has been made to it."""
    graph = onnx.load_from_string(model)
    change(graph)
    path.write_bytes(graph.SerializeToString())
    return path


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda model: model.graph.output.pop(), "is no policy that robosim has exported: its outputs are "),
        (
            lambda model: setattr(model.graph.input[0].type.tensor_type.shape.dim[2], "dim_value", 7),
            "onnxruntime cannot run it",
        ),
        (
            lambda model: model.graph.initializer.pop(),
            "onnxruntime cannot run it: ",
        ),
    ],
    ids=["an output gone", "another size", "weights gone"],
)
def test_a_graph_that_is_no_policy_ends_in_a_sentence(tmp_path, change, sentence):
    folder = make_policy(tmp_path / "made", of_robot=(0, 0, 0))
    policy = read_policy(folder)
    path = changed_graph(tmp_path / "team.onnx", onnx_model(folder), change)
    with pytest.raises(InputError) as caught:
        OnnxPolicy(path).act(random_observations(policy, 2))
    assert str(caught.value).startswith(f"{path}: {sentence}")
    assert "\n" not in str(caught.value)


def test_a_graph_and_a_card_of_other_sizes_are_refused(tmp_path):
    """Or actions that nobody knows: a robot must not be commanded by them."""
    folder = make_policy(tmp_path / "made", of_robot=(0, 0, 0))
    other = onnx.load_from_string(onnx_model(find_policy("paper-1")))
    said = {one.key: one.value for one in other.metadata_props}["card"]

    def swap(model):
        next(one for one in model.metadata_props if one.key == "card").value = said

    small = onnx_model(make_policy(tmp_path / "small", env={"stigmergy": False}, of_robot=(0, 0, 0)))
    path = changed_graph(tmp_path / "team.onnx", small, swap)
    with pytest.raises(InputError) as caught:
        OnnxPolicy(path).card  # noqa: B018
    assert str(caught.value).startswith(f"{path}: its card has observations of ")

    def shift(model):
        graph = model.graph
        chosen = next(node for node in graph.node if ACTIONS in node.output)
        chosen.output[0] = "chosen"
        graph.initializer.append(onnx.numpy_helper.from_array(np.array(-9, np.int64), "nine"))
        graph.node.append(onnx.helper.make_node("Add", ["chosen", "nine"], [ACTIONS], "shift"))

    policy = OnnxPolicy(changed_graph(path, onnx_model(folder), shift))
    with pytest.raises(InputError) as caught:
        policy.act(random_observations(read_policy(folder), 1))
    assert str(caught.value).startswith(f"{path}: chooses actions [-")
    assert str(caught.value).endswith("but must choose from 0 to 4.")


def test_only_the_file_itself_is_read(tmp_path):
    """Weights that lie elsewhere are refused, and a pipe is not waited for."""
    model = onnx.load_from_string(onnx_model(make_policy(tmp_path / "made", of_robot=(0, 0, 0))))
    path = tmp_path / "team.onnx"
    onnx.save(model, path, save_as_external_data=True, location="weights.bin", size_threshold=0)
    with pytest.raises(InputError) as caught:
        OnnxPolicy(path)
    assert str(caught.value).startswith(f"{path}: onnxruntime cannot run it: ")
    os.mkfifo(tmp_path / "pipe.onnx")
    with pytest.raises(InputError) as caught:
        OnnxPolicy(tmp_path / "pipe.onnx")
    assert str(caught.value) == f"{tmp_path}/pipe.onnx: not a regular file, as an ONNX file must be."


def test_damaged_files_are_run_or_refused_in_a_sentence(tmp_path):
    """A few of them here, by a seeded loop."""
    folder = make_policy(tmp_path / "made", of_robot=(0, 0, 0))
    policy, model = read_policy(folder), onnx_model(folder)
    observations, ran = random_observations(policy, 1), 0
    for seed in range(30):
        data = bytearray(model)
        rng = random.Random(seed)
        for _ in range(rng.randrange(1, 4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        try:
            one = OnnxPolicy(bytes(data[: rng.choice([None, None, rng.randrange(len(data))])]))
            one.card  # noqa: B018
            assert one.act(observations).shape == (1, 3)
            ran += 1
        except InputError as error:
            assert "\n" not in str(error), seed
    assert 0 < ran < 30
