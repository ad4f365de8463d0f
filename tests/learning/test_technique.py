import pytest

from robosim.learning.config import run_config
from robosim.learning.technique import find_technique


@pytest.mark.parametrize("technique", ["ps-dqn", "smadrl+"])
def test_teams_that_choose_wheel_speeds_look_further_ahead(technique: str) -> None:
    cardinal, wheels = (run_config(technique, actions=kind).algorithm for kind in ("cardinal", "wheels"))
    assert (cardinal.discount, cardinal.learning_rate) == (0.95, 1e-3)
    assert (wheels.discount, wheels.learning_rate) == (0.98, 3e-3)
    changed = {"discount", "learning_rate"}
    assert cardinal.model_dump(exclude=changed) == wheels.model_dump(exclude=changed)


def test_what_is_asked_for_goes_before_the_technique() -> None:
    algorithm = run_config("ps-dqn", actions="wheels-9", discount=0.9).algorithm
    assert (algorithm.discount, algorithm.learning_rate) == (0.9, 3e-3)


def test_a_changed_technique_keeps_what_it_does_with_wheels() -> None:
    changed = find_technique("ps-dqn").changed("mine", idle_cost=False)
    assert changed.options_with({"actions": "wheels"})["discount"] == 0.98
    assert "discount" not in changed.options_with({})


def test_a_team_of_eight_and_more_learns_by_fewer_updates() -> None:
    updates = [run_config("ps-dqn", robots=n).algorithm.updates_per_step for n in (7, 8, 9)]
    assert updates == [0.5, 0.25, 0.25]
    assert run_config("ps-dqn", robots=8, updates_per_step=0.5).algorithm.updates_per_step == 0.5
    assert find_technique("ps-dqn").changed("mine").options_with({"robots": 8})["updates_per_step"] == 0.25
    assert run_config("iql", robots=8).algorithm.updates_per_step == 0.5
