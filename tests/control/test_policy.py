import hashlib
import json
import os
import struct
import subprocess
import sys
import threading

import numpy as np
import pytest
import safetensors.numpy
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import robosim.control.policy as policy_module
from robosim.control.card import card_text
from robosim.control.network import DRAWING
from robosim.control.policy import Policy, load_policy, policy_names, save_policy, team_digest
from robosim.errors import InputError, shown


@pytest.fixture
def folder(tmp_path, card, weights_of):
    save_policy(tmp_path / "mine", weights_of(card), card)
    return tmp_path / "mine"


def saved_card(folder, card):
    """The card as it is saved with the weights in a folder."""
    digest = hashlib.sha256((folder / "policy.safetensors").read_bytes()).hexdigest()
    return card.changed(weights_sha256=digest)


def without_digest(folder):
    """Take the digest of the weights from a policy's card, so that what is wrong with them is looked at."""
    path = folder / "card.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"weights_sha256": ""}))


def slow_action(weights, card, robot, observation):
    hidden = observation
    for layer in range(len(card.network.layers)):
        hidden = hidden @ weights[f"layer{layer}.weight"][robot] + weights[f"layer{layer}.bias"][robot]
        if layer < len(card.network.layers) - 1:
            if card.network.normalisation == "layer":
                wide = hidden.astype(float)
                hidden = (wide - wide.mean()) / np.sqrt(wide.var() + 1e-5)
            hidden = np.where(hidden > 0, hidden, 0)
            if card.network.normalisation == "rms":
                hidden = hidden / np.sqrt(np.mean(hidden.astype(float) ** 2) + 1e-5)
    return hidden.argmax(), hidden


@pytest.mark.parametrize("batch", [(), (1,), (4,), (2, 3)])
@pytest.mark.parametrize("precision", ["float32", "float16"])
@pytest.mark.parametrize("normalisation", ["none", "rms", "layer"])
def test_acts_as_each_robots_own_network(tmp_path, card_of, weights_of, batch, precision, normalisation):
    card = card_of(network={"normalisation": normalisation, "precision": precision})
    weights = weights_of(card)
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
    assert loaded.card == saved_card(folder, card)
    assert loaded.robots == 3
    observation = np.random.default_rng(1).normal(size=(50, 3, 7)).astype(np.float32)
    kept = Policy(weights_of(card), card)
    assert (loaded.values(observation) == kept.values(observation)).all()


def test_robots_may_run_one_stored_network(tmp_path, card_of, weights_of):
    card = card_of(network={"of_robot": (1, 0, 1)})
    weights = weights_of(card)
    save_policy(tmp_path / "p", weights, card)
    shared = load_policy(tmp_path / "p")
    plain = Policy({name: array[[1, 0, 1]] for name, array in weights.items()}, card_of())
    observation = np.random.default_rng(1).normal(size=(50, 3, 7)).astype(np.float32)
    assert (shared.values(observation) == plain.values(observation)).all()
    kept = shared.weights()
    assert {name: (array == weights[name]).all() for name, array in kept.items()} == dict.fromkeys(
        weights, True
    )
    kept["layer0.bias"][:] = 7.0
    assert (shared.weights()["layer0.bias"] == weights["layer0.bias"]).all()
    with pytest.raises(InputError) as caught:
        Policy(weights_of(card_of()), card)
    assert str(caught.value) == "weights: the shape of layer0.bias is [3, 16], but must be [2, 16]."


@pytest.mark.parametrize("output", ["joint action values", "joint logits"])
def test_one_network_may_choose_for_the_whole_team(tmp_path, card_of, weights_of, output):
    joint = {"input": "team", "inputs": 21, "of_robot": (0, 0, 0), "output": output}
    card = card_of(network=joint)
    weights = weights_of(card)
    save_policy(tmp_path / "p", weights, card)
    policy = load_policy(tmp_path / "p")
    observation = np.random.default_rng(1).uniform(-1, 1, (20, 3, 7)).astype(np.float32)
    actions = policy.act(observation)
    assert policy.values(observation).shape == (20, 125)
    for env in range(20):
        chosen, _ = slow_action(weights, card, 0, observation[env].ravel())
        assert actions[env].tolist() == [chosen // 25, chosen // 5 % 5, chosen % 5]
    with pytest.raises(InputError, match=r"its last two axes must be robots and size, \(3, 7\)."):
        policy.act(np.zeros((4, 7)))


def test_one_network_for_all_drives_a_team_of_any_size(tmp_path, card_of, weights_of):
    card = card_of(network={"of_robot": (0, 0, 0)})
    weights = weights_of(card)
    save_policy(tmp_path / "p", weights, card)
    policy = load_policy(tmp_path / "p")
    assert (card.network.shared, policy.robots) == (True, 3)
    for robots in (1, 3, 8):
        observation = np.random.default_rng(robots).normal(size=(20, robots, 7)).astype(np.float32)
        actions = policy.act(observation)
        assert actions.shape == (20, robots)
        for place in np.ndindex(actions.shape):
            _, values = slow_action(weights, card, 0, observation[place])
            np.testing.assert_allclose(policy.values(observation)[place], values, rtol=2e-3, atol=2e-3)
    for shape in ((7,), (2, 0, 7)):
        with pytest.raises(InputError, match=r"^observation has shape \(.*7.*\): its last two axes must be"):
            policy.act(np.zeros(shape))


def test_blocked_moves_are_worth_nothing_and_not_taken(card_of, weights_of):
    names = [f"number {i}" for i in range(9)]
    for first, goal in ((0, "home"), (4, "source")):
        names[first : first + 4] = [f"gain {goal} {side}" for side in "NSWE"]
    card = card_of(size=9, observation=names, network={"mask": True})
    free = card_of(size=9, observation=names)
    weights = weights_of(card)
    rng = np.random.default_rng(0)
    observation = rng.uniform(-0.99, 1.0, (200, 3, 9)).astype(np.float32)
    home, source = rng.random((2, 200, 3, 4)) < 0.6
    observation[..., 0:4][home] = -1.0
    observation[..., 4:8][source] = -1.0
    values, unmasked = (Policy(weights, one).values(observation) for one in (card, free))
    blocked = np.concatenate([home & source, np.zeros((200, 3, 1), bool)], axis=2)
    assert (values == np.where(blocked, -np.inf, unmasked)).all()
    taken = np.take_along_axis(blocked, Policy(weights, card).act(observation)[..., None], axis=2)
    assert blocked.any()
    assert not taken.any()


def test_a_mask_needs_observations_that_hold_the_gains_of_moves(card_of):
    names = [f"gain {goal} {side}" for goal in ("home", "source") for side in "NSWE"]
    card_of(size=8, observation=names, network={"mask": True})
    # Four and four in a row, or nothing can be read from them.
    for odd in (
        {"observation": names[::-1]},
        {"observation": [*names[1:], "x"]},
        {"env": {"actions": "wheels"}},
    ):
        with pytest.raises(InputError) as caught:
            card_of(**({"size": 8, "observation": names, "network": {"mask": True}} | odd))
        assert str(caught.value) == (
            f"network.mask is {shown(True)}, but must be {shown(False)} where "
            "observations hold no gains of moves."
        )


def test_few_stored_networks_cannot_fill_the_memory(tmp_path, card_of):
    network = {"hidden": (4096,) * 8, "of_robot": (0,) * 999 + (1,)}
    huge = card_of(robots=1000, network=network, evaluation=None)
    folder = tmp_path / "p"
    folder.mkdir()
    (folder / "card.json").write_text(card_text(huge))
    (folder / "policy.safetensors").write_bytes(b"")
    assert "need more than 2000000000 bytes, the most a policy may take." in refused(folder)


@pytest.mark.parametrize("normalisation", ["none", "rms", "layer"])
def test_weights_that_overflow_together_are_refused_in_both_directions(
    folder, card_of, weights_of, normalisation
):
    card = card_of(network={"normalisation": normalisation})
    weights = {name: array * np.float32(1e30) for name, array in weights_of(card).items()}
    with pytest.raises(InputError) as caught:
        save_policy(folder, weights, card)
    reason = str(caught.value).removeprefix("weights: ")
    assert reason.startswith("numbers in layer")
    assert reason.endswith(", or they overflow.")
    (folder / "card.json").write_text(card_text(card))
    safetensors.numpy.save_file(weights, folder / "policy.safetensors")
    assert refused(folder) == f"/policy.safetensors: {reason}"


@pytest.mark.parametrize(("said", "other"), [("float32", "float16"), ("float16", "float32")])
def test_precision_must_be_the_one_that_the_card_says(tmp_path, card_of, weights_of, said, other):
    card, wrong = (card_of(network={"precision": precision}) for precision in (said, other))
    save_policy(tmp_path / "p", weights_of(card), card)
    without_digest(tmp_path / "p")
    safetensors.numpy.save_file(weights_of(wrong), tmp_path / "p" / "policy.safetensors")
    assert refused(tmp_path / "p").endswith(f": layer0.bias is of type {other}, but must be {said}.")


def test_rounded_weights_are_computed_with_in_float32(card_of, weights_of):
    card = card_of(network={"precision": "float16"})
    half = weights_of(card)
    widened = {name: array.astype(np.float32) for name, array in half.items()}
    observation = np.random.default_rng(1).normal(size=(50, 3, 7)).astype(np.float32)
    values = Policy(half, card).values(observation)
    assert values.dtype == np.float32
    assert (values == Policy(widened, card_of()).values(observation)).all()


def test_both_files_are_readable_as_others_are(folder, tmp_path):
    (tmp_path / "other").touch()
    modes = {path.stat().st_mode for path in (*folder.iterdir(), tmp_path / "other")}
    assert len(modes) == 1


def test_the_lowest_of_equal_actions_is_taken(card, weights_of):
    weights = {name: np.zeros_like(array) for name, array in weights_of(card).items()}
    weights["layer2.bias"][:, 2:4] = 1.0
    assert (Policy(weights, card).act(np.ones((3, 7))) == 2).all()


def test_names_sort_by_the_numbers_in_them(tmp_path, card, weights_of, monkeypatch):
    for name in ("paper-16", "paper-2", "paper-2-half", "a1b10", "a1b9", "zoo"):
        save_policy(tmp_path / name, weights_of(card), card)
    monkeypatch.setattr(policy_module, "shipped_folder", lambda kind: tmp_path)
    assert policy_names() == ["a1b9", "a1b10", "paper-2", "paper-2-half", "paper-16", "zoo"]


def test_a_policy_runs_without_the_libraries_of_physics_learning_and_playback():
    code = (
        "import sys, numpy, robosim; robosim.load_policy('paper-8').act(numpy.zeros((8, 143)));"
        "import robosim.control.controller, robosim.control.environment, robosim.envs.vector;"
        "print({name.split('.')[0] for name in sys.modules} & "
        "{'pymunk', 'torch', 'rerun', 'matplotlib', 'pyarrow', 'rich'})"
    )
    run = [sys.executable, "-c", code]
    result = subprocess.run(run, capture_output=True, text=True, timeout=60, check=True)
    assert result.stdout == "set()\n"


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
    assert load_policy(tmp_path / "run").card == saved_card(tmp_path / "run" / "policy", card)


def test_shipped_policies_go_by_name(tmp_path, card, weights_of, monkeypatch):
    save_policy(tmp_path / "paper-2", weights_of(card), card)
    monkeypatch.setattr(policy_module, "shipped_folder", lambda kind: tmp_path)
    monkeypatch.chdir("/")
    assert load_policy("paper-2").card == saved_card(tmp_path / "paper-2", card)
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
    assert refused(folder) == "/policy.safetensors: there is no such weights file."
    weights.mkdir()
    assert refused(folder) == "/policy.safetensors: this is a directory; a weights file is needed here."
    weights.rmdir()
    os.mkfifo(weights)
    assert refused(folder) == "/policy.safetensors: not a regular file, as a weights file must be."


def test_every_truncation_is_refused(folder):
    without_digest(folder)
    weights = folder / "policy.safetensors"
    data = weights.read_bytes()
    for length in {0, 1, 7, 8, 9, len(data) // 2, len(data) - 1}:
        weights.write_bytes(data[:length])
        assert refused(folder).startswith("/policy.safetensors: not a whole safetensors file (")
    weights.write_bytes(data + b"x")
    assert refused(folder).startswith("/policy.safetensors: not a whole safetensors file (")


def test_huge_header_and_huge_file_are_refused_unread(folder):
    without_digest(folder)
    weights = folder / "policy.safetensors"
    weights.write_bytes(struct.pack("<Q", 2**62) + b"{}")
    assert refused(folder).startswith("/policy.safetensors: not a whole safetensors file (")
    with weights.open("wb") as file:
        file.truncate(2**40)
    assert refused(folder).endswith(", the most that a weights file may have.")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda w: w.pop("layer1.bias"), 'tensor "layer1.bias" is missing.'),
        (
            lambda w: w.update(extra=np.zeros(1, np.float32)),
            'tensor "extra" is too many; the card has 3 layers.',
        ),
        (
            lambda w: w.update({"layer0.bias": np.zeros((3, 15), np.float32)}),
            "the shape of layer0.bias is [3, 15], but must be [3, 16].",
        ),
        (
            lambda w: w.update({"layer0.bias": np.zeros((3, 16))}),
            "layer0.bias is of type float64, but must be float32.",
        ),
        (
            lambda w: w.update({"layer0.bias": np.full((3, 16), np.nan, np.float32)}),
            "layer0.bias holds a number that is not finite.",
        ),
    ],
)
def test_weights_that_do_not_fit_the_card_are_refused_in_both_directions(
    folder, card, weights_of, change, sentence
):
    weights = weights_of(card)
    change(weights)
    with pytest.raises(InputError) as caught:
        save_policy(folder, weights, card)
    assert str(caught.value) == f"weights: {sentence}"
    assert load_policy(folder).card == saved_card(folder, card)
    without_digest(folder)
    safetensors.numpy.save_file(weights, folder / "policy.safetensors")
    assert refused(folder) in (
        f"/policy.safetensors: {sentence}",
        '/policy.safetensors: "layer0.bias" is of type F64, but must be F32 or F16.',
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
    with pytest.raises(InputError, match='holds "thesis.tex", so it is not replaced by a policy'):
        save_policy(tmp_path, weights_of(card), card)
    with pytest.raises(InputError, match="this is a file; a policy is written to a folder"):
        save_policy(tmp_path / "thesis.tex", weights_of(card), card)
    with pytest.raises(InputError, match="the policy cannot be written: "):
        save_policy(tmp_path / "thesis.tex" / "p", weights_of(card), card)
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


@given(st.data())
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_bit_of_the_weights_changes_unnoticed(folder, data):
    path = folder / "policy.safetensors"
    whole = path.read_bytes()
    flipped = bytearray(whole)
    bit = data.draw(st.integers(0, 8 * len(whole) - 1))
    flipped[bit // 8] ^= 1 << bit % 8
    path.write_bytes(flipped)
    sentence = refused(folder)
    path.write_bytes(whole)
    assert sentence == "/policy.safetensors: not the weights of this card: their SHA-256 is another."


def test_a_policy_stays_when_the_new_one_cannot_take_its_place(folder, card, weights_of, monkeypatch):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    rename = type(folder).rename

    def full(path, target):
        if path.name == "new":
            raise OSError(28, "No space left on device")
        return rename(path, target)

    monkeypatch.setattr(type(folder), "rename", full)
    with pytest.raises(InputError, match=r"mine: the policy cannot be written: No space left on device\.$"):
        save_policy(folder, weights_of(card), card)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert [path.name for path in folder.parent.iterdir()] == ["mine"]


def test_records_know_a_team_by_its_weights_and_by_what_robots_in_place_do(tmp_path, card_of, weights_of):
    gains = tuple(f"gain {goal} {side}" for goal in ("home", "source") for side in "NSWE")
    card, folder = card_of(size=10, observation=("in place", "laden", *gains)), tmp_path / "p"
    digests = []
    warm: tuple[tuple[float | None, ...], ...] = (
        (0.5, None, None, None), (0.5, 2.0, None, None), (0.5, 3.0, None, None), (0.5, None, 8, None),
        (0.5, 2.0, 8, None), (0.5, 2.0, 8, 6),
    )  # fmt: skip
    for drawing in ((None, None, None, None), *warm):
        network = card.network.changed(**dict(zip(DRAWING, drawing, strict=True)))
        save_policy(folder, weights_of(card), card.changed(network=network))
        digests.append(team_digest(folder))
    weights = hashlib.sha256((folder / "policy.safetensors").read_bytes()).hexdigest()
    assert digests[:2] == [weights, weights]
    assert len(set(digests)) == 6
