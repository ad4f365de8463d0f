import pytest

import robosim.control.policy as policy_module
from robosim.control.controller import SCRIPTED, make_controller
from robosim.control.lanes import LanesController
from robosim.control.learned import LearnedController
from robosim.control.policy import save_policy
from robosim.errors import InputError, printable


@pytest.fixture
def ships(tmp_path, monkeypatch, card, weights_of):
    """A folder of policies in the place of those that ship."""
    folder = tmp_path / "ships"
    save_policy(folder / "paper-3", weights_of(card), card)
    monkeypatch.setattr(policy_module, "shipped_folder", lambda kind: folder)
    return folder


def test_every_scripted_controller_goes_by_its_name(ships):
    for name in SCRIPTED:
        assert make_controller(name).name == name


def test_a_policy_that_ships_goes_by_its_name(ships, card, monkeypatch):
    monkeypatch.chdir("/")
    controller = make_controller("paper-3")
    assert isinstance(controller, LearnedController)
    saved = controller.policy.card.changed(weights_sha256="")
    assert (controller.name, saved) == ("paper-3", card)


def test_scripted_controllers_come_before_policies_and_those_before_folders(
    ships, tmp_path, card_of, weights_of, monkeypatch
):
    own = card_of(notes="my own")
    for name in ("lanes", "paper-3"):
        save_policy(tmp_path / name, weights_of(own), own)
    save_policy(ships / "lanes", weights_of(own), own)
    monkeypatch.chdir(tmp_path)
    assert isinstance(make_controller("lanes"), LanesController)
    assert make_controller("paper-3").policy.card.notes == ""
    for path in ("./lanes", "./paper-3", tmp_path / "lanes"):
        assert make_controller(path).policy.card.notes == "my own"


@pytest.mark.parametrize(
    ("name", "end"),
    [
        ("lans", "did you mean lanes or random or lorenz?"),
        ("paper-4", "did you mean paper-3?"),
        ("qqqq", "known names are active, lanes, lorenz, paper-3, random, reversal."),
        ("no\0name", "known names are active, lanes, lorenz, paper-3, random, reversal."),
        ("\033[31m", "known names are active, lanes, lorenz, paper-3, random, reversal."),
        ("x" * 5000, "known names are active, lanes, lorenz, paper-3, random, reversal."),
    ],
)
def test_unknown_names_are_a_sentence_with_the_nearest(ships, name, end):
    with pytest.raises(InputError) as caught:
        make_controller(name)
    assert str(caught.value) == (
        f"no policy is named '{printable(name, 200)}', and there is no such folder: {end}"
    )
