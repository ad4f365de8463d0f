import pytest

from robosim.learning.config import run_config
from robosim.learning.idle import IdleOption, idle_options

CURRICULUM = ("fine_tune", "first_share", "first_team", "newcomer", "steady_gain")


@pytest.mark.parametrize(
    ("technique", "options", "idle"),
    [
        ("ps-dqn", {"fine_tune": 0.5, "steps": 10}, ["fine_tune"]),
        ("smadrl", {"fine_tune": 0.5, "first_team": 3}, []),
        ("smadrl", {"stigmergy": False, "pheromone_decay": 0.2}, ["pheromone_decay"]),
        ("ps-dqn", {"exploration": 0.2, "epsilon_start": 0.5}, []),
        ("ps-dqn", {"exploration": 0.2, "start_from": "any"}, ["exploration"]),
        # Newcomers begin from nothing, and explore.
        ("smadrl", {"exploration": 0.2, "start_from": "paper-2"}, []),
        ("qmix", {"hyper_width": 8}, []),
        ("vdn", {"hyper_width": 8}, ["hyper_width"]),
        ("iql", {"mask": True, "encoding": "paper"}, ["mask"]),
        ("iql", {"mask": True, "neighbours": False}, []),
        ("ps-dqn", {"mask": False, "encoding": "paper"}, []),
        ("smadrl", {"newcomer": "copy", "robots": 2}, ["newcomer"]),
        ("smadrl", {"newcomer": "copy", "robots": 3}, []),
        ("smadrl", {"newcomer": "copy", "robots": 3, "start_from": "paper-2"}, []),
        ("iql", {"evaluation_episodes": 0, "evaluation_steps": 20}, ["evaluation_steps"]),
        ("iql", {"evaluation_episodes": 0, "evaluation_profile": "harsh"}, ["evaluation_profile"]),
        ("iql", {"evaluation_episodes": 0, "evaluation_profile": "harsh", "record_every": 9}, []),
        ("ps-dqn", {"random_arenas": 10, "random_share": 0.5}, []),
        ("ps-dqn", {"arenas": ["paper"], "random_share": 0.5}, ["random_share"]),
    ],
)
def test_options_are_idle_where_what_they_matter_with_is_not_there(technique, options, idle):
    found = list(idle_options(run_config(technique, **options), options))
    assert [one.name for one in found] == idle
    assert all(bool(one.needs) != bool(one.why) for one in found)


def test_all_options_of_a_curriculum_need_one():
    found = list(idle_options(run_config("iql"), CURRICULUM))
    assert found == [IdleOption(name, needs="curriculum") for name in CURRICULUM]
