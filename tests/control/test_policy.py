import json
import os
import struct
import threading

import numpy as np
import pytest
import safetensors.numpy

import robosim.control.policy as policy_module
from robosim.control.card import NetworkCard, ObservationCard, TechniqueCard, card_text
from robosim.control.policy import Policy, load_policy, save_policy
from robosim.errors import InputError

PLAIN = {"name": "iql", "global_reward": False, "stigmergy": False, "curriculum": False}


@pytest.fixture
def folder(tmp_path, card, weights_of):
    save_policy(tmp_path / "mine", weights_of(card), card)
    return tmp_path / "mine"


def slow_action(weights, card, robot, observation):
    hidden = observation
    for layer in range(len(card.layers)):
        hidden = hidden @ weights[f"layer{layer}.weight"][robot] + weights[f"layer{layer}.bias"][robot]
        if layer < len(card.layers) - 1:
            hidden = np.where(hidden > 0, hidden, 0)
            if card.technique.normalised:
                hidden = hidden / np.sqrt(np.mean(hidden.astype(float) ** 2) + 1e-5)
    return hidden.argmax(), hidden


@pytest.mark.parametrize("batch", [(), (1,), (4,), (2, 3)])
@pytest.mark.parametrize("dtype", [np.float32, np.float16])
@pytest.mark.parametrize("normalised", [False, True])
def test_acts_as_each_robots_own_network(tmp_path, card_of, weights_of, batch, dtype, normalised):
    card = card_of(technique=TechniqueCard(**PLAIN, normalised=normalised))
    weights = weights_of(card, dtype=dtype)
    save_policy(tmp_path / "p", weights, card)
    policy = load_policy(tmp_path / "p")
    observation = np.random.default_rng(1).normal(size=(*batch, 3, 7)).astype(np.float32)
    actions = policy.act(observation)
    assert actions.dtype == np.int64
    assert actions.shape == (*batch, 3)
    for place in np.ndindex(actions.shape):
        action, values = slow_action(weights, card, place[-1], observation[place])
        assert actions[place] == action
        np.testing.assert_allclose(policy.values(observation)[place], values, rtol=2e-3, atol=2e-3)


def test_loaded_policy_is_the_saved_one(folder, card, weights_of):
    loaded = load_policy(str(folder))
    assert loaded.card == card
    assert loaded.robots == 3
    observation = np.random.default_rng(1).normal(size=(50, 3, 7)).astype(np.float32)
    kept = Policy(weights_of(card), card)
    assert (loaded.values(observation) == kept.values(observation)).all()


def test_robots_may_run_one_stored_network(tmp_path, card_of, weights_of):
    card = card_of(network=NetworkCard(hidden=(16, 12), of_robot=(1, 0, 1)))
    weights = {name: array[:2] for name, array in weights_of(card).items()}
    save_policy(tmp_path / "p", weights, card)
    shared = load_policy(tmp_path / "p")
    plain = Policy({name: array[[1, 0, 1]] for name, array in weights.items()}, card_of())
    observation = np.random.default_rng(1).normal(size=(50, 3, 7)).astype(np.float32)
    assert (shared.values(observation) == plain.values(observation)).all()
    given = {name: (array == weights[name][[1, 0, 1]]).all() for name, array in shared.weights().items()}
    assert given == dict.fromkeys(weights, True)
    with pytest.raises(InputError, match=r"'layer0.bias' has shape \(3, 16\); the card says \(2, 16\)."):
        Policy(weights_of(card), card)


def test_one_network_for_all_drives_a_team_of_any_size(tmp_path, card_of, weights_of):
    card = card_of(network=NetworkCard(hidden=(16, 12), of_robot=(0, 0, 0)))
    weights = {name: array[:1] for name, array in weights_of(card).items()}
    save_policy(tmp_path / "p", weights, card)
    policy = load_policy(tmp_path / "p")
    assert (card.shared, policy.robots, policy.weights()["layer0.weight"].shape[0]) == (True, 3, 3)
    for robots in (1, 3, 8):
        observation = np.random.default_rng(robots).normal(size=(20, robots, 7)).astype(np.float32)
        actions = policy.act(observation)
        assert actions.shape == (20, robots)
        for place in np.ndindex(actions.shape):
            _, values = slow_action(weights, card, 0, observation[place])
            np.testing.assert_allclose(policy.values(observation)[place], values, rtol=2e-3, atol=2e-3)
    with pytest.raises(InputError, match=r"observation has shape \(7,\)"):
        policy.act(np.zeros(7))


def test_blocked_moves_are_worth_nothing_and_not_taken(card_of, weights_of):
    names = [f"number {i}" for i in range(9)]
    for first, goal in ((0, "home"), (4, "source")):
        names[first : first + 4] = [f"gain {goal} {side}" for side in "NSWE"]
    observed = ObservationCard(encoding="expanded", stigmergy=True, names=tuple(names))
    card = card_of(technique=TechniqueCard(**PLAIN, action_mask=True), observation=observed)
    free = card_of(observation=observed)
    weights = weights_of(card)
    rng = np.random.default_rng(0)
    observation = rng.uniform(-0.99, 1.0, (200, 3, 9)).astype(np.float32)
    home, source = rng.random((2, 200, 3, 4)) < 0.6
    observation[..., 0:4][home] = -1.0
    observation[..., 4:8][source] = -1.0
    values, unmasked = (Policy(weights, one).values(observation) for one in (card, free))
    closed = np.concatenate([home & source, np.zeros((200, 3, 1), bool)], axis=2)
    assert (values == np.where(closed, -np.inf, unmasked)).all()
    taken = np.take_along_axis(closed, Policy(weights, card).act(observation)[..., None], axis=2)
    assert closed.any()
    assert not taken.any()
    wheels = card_of(technique=card.technique, observation=observed, actions="wheels")
    assert (Policy(weights, wheels).values(observation) == unmasked).all()
    # Numbers that are not four and four in a row tell no ways.
    for names in (observed.names[::-1], (*observed.names[1:], "gain home N"), ("a",) * 9):
        other = ObservationCard(encoding="expanded", stigmergy=True, names=names)
        odd = card_of(technique=card.technique, observation=other)
        assert (Policy(weights, odd).values(observation) == unmasked).all()


def test_a_mask_needs_all_cardinal_actions(tmp_path, card_of, weights_of):
    card = card_of()
    save_policy(tmp_path / "p", weights_of(card), card)
    text = card_text(card).replace('"action_mask": false', '"action_mask": true')
    (tmp_path / "p" / "card.json").write_text(text.replace('"num_actions": 5', '"num_actions": 3'))
    assert refused(tmp_path / "p") == ("/card.json: num_actions must be 5 for technique.action_mask.")


def test_few_stored_networks_cannot_fill_the_memory(tmp_path, card_of):
    network = NetworkCard(hidden=(4096,) * 8, of_robot=(0,) * 1000)
    huge = card_of(robots=1000, network=network, evaluation=None)
    folder = tmp_path / "p"
    folder.mkdir()
    (folder / "card.json").write_text(card_text(huge))
    (folder / "policy.safetensors").write_bytes(b"")
    assert "need more than 2000000000 bytes, the most a policy may take." in refused(folder)


@pytest.mark.parametrize(("said", "is_"), [("float32", np.float16), ("float16", np.float32)])
def test_precision_must_be_the_one_that_the_card_says(tmp_path, card_of, weights_of, said, is_):
    card = card_of(network=NetworkCard(hidden=(16, 12), precision=said))
    save_policy(tmp_path / "p", weights_of(card, dtype=said), card)
    safetensors.numpy.save_file(weights_of(card, dtype=is_), tmp_path / "p" / "policy.safetensors")
    told = f"'layer0.bias' is of type {np.dtype(is_)}; the card says {said}."
    assert refused(tmp_path / "p").endswith(told)


def test_rounded_weights_are_computed_with_in_float32(card, weights_of):
    half = weights_of(card, dtype=np.float16)
    widened = {name: array.astype(np.float32) for name, array in half.items()}
    observation = np.random.default_rng(1).normal(size=(50, 3, 7)).astype(np.float32)
    values = Policy(half, card).values(observation)
    assert values.dtype == np.float32
    assert (values == Policy(widened, card).values(observation)).all()


def test_both_files_are_readable_as_others_are(folder, tmp_path):
    (tmp_path / "other").touch()
    modes = {path.stat().st_mode for path in (*folder.iterdir(), tmp_path / "other")}
    assert len(modes) == 1


def test_the_lowest_of_equal_actions_is_taken(card, weights_of):
    weights = {name: np.zeros_like(array) for name, array in weights_of(card).items()}
    weights["layer2.bias"][:, 2:4] = 1.0
    assert (Policy(weights, card).act(np.ones((3, 7))) == 2).all()


@pytest.mark.parametrize(
    ("observation", "sentence"),
    [
        (
            np.zeros((2, 7)),
            "observation has shape (2, 7): its last two axes must be robots and size, (3, 7).",
        ),
        (np.zeros(7), "observation has shape (7,): its last two axes must be robots and size, (3, 7)."),
        (
            np.where(np.arange(21).reshape(3, 7) == 9, np.nan, 0.0),
            "observation is nan at (1, 2), the 'number 2' of robot 1: it must be a finite number.",
        ),
        ("north", "observation is not an array of numbers: could not convert string to float: 'north'."),
    ],
)
def test_wrong_observation_is_a_sentence(card, weights_of, observation, sentence):
    with pytest.raises(InputError) as caught:
        Policy(weights_of(card), card).act(observation)
    assert str(caught.value) == sentence


def test_a_run_folder_stands_for_its_policy(tmp_path, card, weights_of):
    save_policy(tmp_path / "run" / "policy", weights_of(card), card)
    assert load_policy(tmp_path / "run").card == card


def test_shipped_policies_go_by_name(tmp_path, card, weights_of, monkeypatch):
    save_policy(tmp_path / "paper-2", weights_of(card), card)
    monkeypatch.setattr(policy_module, "shipped_folder", lambda kind: tmp_path)
    monkeypatch.chdir("/")
    assert load_policy("paper-2").card == card
    with pytest.raises(InputError) as caught:
        load_policy("papper-2")
    assert str(caught.value) == (
        "no policy is named 'papper-2', and there is no such folder: did you mean paper-2?"
    )


def refused(path):
    with pytest.raises(InputError) as caught:
        load_policy(path)
    assert "\n" not in str(caught.value)
    return str(caught.value).replace(str(path), "")


def test_what_is_no_policy_is_refused(tmp_path, folder):
    assert "there is no such folder" in refused(tmp_path / "nothing")
    assert "there is no such folder" in refused("no\0name")
    assert refused(folder / "card.json") == ": this is a file; give the policy's folder."
    empty = tmp_path / "empty"
    empty.mkdir()
    assert refused(empty) == (
        ": neither a policy folder (card.json and policy.safetensors) nor a run folder (policy/)."
    )


def test_missing_and_wrong_kinds_of_files_are_refused(folder):
    weights = folder / "policy.safetensors"
    weights.unlink()
    assert refused(folder) == "/policy.safetensors: there is no such file."
    weights.mkdir()
    assert refused(folder) == "/policy.safetensors: this is a directory; a file is needed here."
    weights.rmdir()
    os.mkfifo(weights)
    assert refused(folder) == "/policy.safetensors: not a regular file."


def test_every_truncation_is_refused(folder):
    weights = folder / "policy.safetensors"
    data = weights.read_bytes()
    for length in {0, 1, 7, 8, 9, len(data) // 2, len(data) - 1}:
        weights.write_bytes(data[:length])
        assert refused(folder).startswith("/policy.safetensors: not a whole safetensors file (")
    weights.write_bytes(data + b"x")
    assert refused(folder).startswith("/policy.safetensors: not a whole safetensors file (")


def test_huge_header_and_huge_file_are_refused_unread(folder):
    weights = folder / "policy.safetensors"
    weights.write_bytes(struct.pack("<Q", 2**62) + b"{}")
    assert refused(folder).startswith("/policy.safetensors: not a whole safetensors file (")
    with weights.open("wb") as file:
        file.truncate(2**40)
    assert "the most it may have" in refused(folder)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda w: w.pop("layer1.bias"), "tensor 'layer1.bias' is missing."),
        (lambda w: w.update(extra=np.zeros(1)), "tensor 'extra' is not one of 3 layers."),
        (
            lambda w: w.update({"layer0.bias": np.zeros((3, 15), np.float32)}),
            "'layer0.bias' has shape (3, 15); the card says (3, 16).",
        ),
        (
            lambda w: w.update({"layer0.bias": np.zeros((3, 16))}),
            "'layer0.bias' is of type float64: it must be float32 or float16.",
        ),
        (
            lambda w: w.update({"layer0.bias": np.full((3, 16), np.nan, np.float32)}),
            "'layer0.bias' holds a number that is not finite.",
        ),
    ],
)
def test_weights_that_do_not_fit_the_card_are_refused_both_ways(folder, card, weights_of, change, sentence):
    weights = weights_of(card)
    change(weights)
    with pytest.raises(InputError) as caught:
        save_policy(folder, weights, card)
    assert str(caught.value) == f"weights: {sentence}"
    assert load_policy(folder).card == card
    safetensors.numpy.save_file(weights, folder / "policy.safetensors")
    told = refused(folder)
    assert told in (
        f"/policy.safetensors: {sentence}",
        "/policy.safetensors: 'layer0.bias' is of type F64: it must be F32 or F16.",
        "/policy.safetensors: 'extra' is of type F64: it must be F32 or F16.",
    )


def test_replacing_leaves_nothing_behind_and_never_half(tmp_path, card, weights_of):
    target = tmp_path / "p"
    save_policy(target, weights_of(card, seed=0), card)
    broken = []
    done = threading.Event()

    def read_on():
        while not done.is_set():
            try:
                weights = safetensors.numpy.load_file(target / "policy.safetensors")
                json.loads((target / "card.json").read_text())
            except FileNotFoundError:
                continue
            except Exception as error:
                broken.append(error)
                return
            if len(weights) != 6:
                broken.append(weights)

    reader = threading.Thread(target=read_on)
    reader.start()
    for seed in range(20):
        save_policy(target, weights_of(card, seed=seed), card)
    done.set()
    reader.join()
    assert broken == []
    assert [path.name for path in tmp_path.iterdir()] == ["p"]
    expected = weights_of(card, seed=19)["layer0.weight"]
    assert (safetensors.numpy.load_file(target / "policy.safetensors")["layer0.weight"] == expected).all()


def test_a_folder_with_other_things_is_never_replaced(tmp_path, card, weights_of):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="holds 'thesis.tex', so it is not replaced by a policy"):
        save_policy(tmp_path, weights_of(card), card)
    with pytest.raises(InputError, match="this is a file; a policy is written to a folder"):
        save_policy(tmp_path / "thesis.tex", weights_of(card), card)
    with pytest.raises(InputError, match="the policy cannot be written: "):
        save_policy(tmp_path / "thesis.tex" / "p", weights_of(card), card)
    assert (tmp_path / "thesis.tex").read_text() == "years of work"
