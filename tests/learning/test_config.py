import pickle
import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.envs.variety import VarietyConfig
from robosim.errors import InputError
from robosim.learning.config import RunConfig, read_config, run_config, write_config
from robosim.learning.technique import TECHNIQUES, Technique, find_technique


@given(
    technique=st.sampled_from(sorted(TECHNIQUES)),
    arena=st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=30),
    learning_rate=st.floats(1e-8, 1.0),
    hidden=st.lists(st.integers(1, 4096), min_size=1, max_size=8).map(tuple),
    seed=st.integers(0, 2**63 - 1),
    overlap=st.booleans(),
)
def test_config_survives_its_file(tmp_path_factory, technique, arena, learning_rate, hidden, seed, overlap):
    path = tmp_path_factory.mktemp("config") / "config.toml"
    config = run_config(
        technique, arena=arena, learning_rate=learning_rate, hidden=hidden, seed=seed, overlap=overlap
    )
    write_config(config, path)
    assert read_config(path) == config
    assert type(read_config(path).algorithm) is type(config.algorithm)
    assert list(tomllib.loads(path.read_text())) == ["env", "algorithm", "schedule", "run"]
    assert pickle.loads(pickle.dumps(config)) == config


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("robots = ", "not a TOML file (Invalid value (at end of document))."),
        ("robots = 2", '"robots" is no table: known names are algorithm, env, run, schedule, variety.'),
        ("env = 2", "env is 2, but must be a table."),
        ('[env]\nrobots = "two"', 'env.robots is "two", but must be a whole number from 1 to 1000.'),
        ("[env]\nrobots = true", "env.robots is true, but must be a whole number from 1 to 1000."),
        ("[env]\nrobot = 2", '"robot" is not an option of env: did you mean robots or pheromone?'),
        (
            '[env]\nactions = "jump"',
            'env.actions is "jump", but must be "cardinal" or "wheels" or "wheels-9".',
        ),
        ("[env.pheromone]\ndecay = 2.0", "env.pheromone.decay is 2.0, but must be a number from 1e-06 to 1."),
        (
            "[algorithm]\ndiscount = nan",
            "algorithm: discount is nan, but must be a number from 0 to 0.99999.",
        ),
        (
            "[algorithm]\nhidden = []",
            "algorithm: hidden is [], but must be a list of 1 to 8 whole numbers from 1 to 4096.",
        ),
        (
            '[algorithm]\nname = "ia2c"\nepsilon_end = 0.1',
            'algorithm: "epsilon_end" is not an option: did you mean learning_rate_end?',
        ),
        (
            '[algorithm]\nname = "dqm"',
            'algorithm: unknown algorithm "dqm": did you mean dqn or qmix or madqn?',
        ),
        (
            "[algorithm]\nepsilon_start = 0.01",
            "algorithm: epsilon_end is 0.02, but must be a number of at most epsilon_start, 0.01.",
        ),
        ("[run]\noverlap = 1", "run.overlap is 1, but must be true or false."),
        ('[schedule]\nnewcomer = "clone"', 'schedule.newcomer is "clone", but must be "scratch" or "copy".'),
        (
            '[schedule]\ncurriculum = true\n[algorithm]\nparameters = "shared"',
            "curriculum is true, but must be false where robots share a network: it cannot be frozen beside "  # noqa: ISC004
            "itself.",
        ),
        ("[run]\nworkers = 9", "workers is 9, but must be a whole number from 1 to num_envs, 8."),
    ],
)
def test_wrong_file_is_one_sentence(tmp_path, text, sentence):
    path = tmp_path / "config.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_config(path)
    assert str(caught.value).removeprefix(f"{path}: ") == sentence


@pytest.mark.parametrize("text", [f"[run]\nseed = 1{'0' * 5000}", f"run = {'[' * 5000}"])
def test_what_python_cannot_read_of_a_file_is_one_sentence(tmp_path, text):
    """Numbers of thousands of digits, and thousands of brackets: the words are Python's."""
    path = tmp_path / "config.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"^[^\n]*config.toml: not a TOML file \(.+\)\.$"):
        read_config(path)


def test_missing_keys_take_their_defaults(tmp_path):
    path = tmp_path / "config.toml"
    path.write_text("[env]\nrobots = 5\n[env.pheromone]\nradius = 1")
    config = read_config(path)
    assert config == RunConfig().with_options(robots=5, pheromone_radius=1)
    assert config.env.episode_steps == 1250


def test_missing_file_is_a_sentence(tmp_path):
    with pytest.raises(InputError, match=r"nowhere.toml: there is no such run configuration\.$"):
        read_config(tmp_path / "nowhere.toml")


@pytest.mark.parametrize(
    ("technique", "options", "sentence"),
    [
        ("iql+gss", {}, 'unknown technique "iql+gss": did you mean iql+gs or iql+s or iql+g?'),
        ("iql", {"robots": 0}, "env.robots is 0, but must be a whole number from 1 to 1000."),
        (
            "iql",
            {"robot": 2},
            '"robot" is not an option: did you mean robots or motion_robot_mass or sensing_dropout?',
        ),
        (
            "ia2c",
            {"replay_capacity": 2},
            '"replay_capacity" is not an option: did you mean steady_gain or reward_scale or reward_pickup?',
        ),
        (
            "iql",
            {"learning_rate": 7.0},
            "algorithm: learning_rate is 7.0, but must be a number from 1e-08 to 1.",
        ),
    ],
)
def test_wrong_options_are_one_sentence(technique, options, sentence):
    with pytest.raises(InputError) as caught:
        run_config(technique, **options)
    assert str(caught.value) == sentence


def test_short_names_reach_every_table():
    config = run_config(
        robots=4, sharing="split", pheromone_decay=0.2, learning_rate=5e-3, workers=2, steps=7
    )
    assert (config.env.robots, config.env.reward.sharing, config.env.pheromone.decay) == (4, "split", 0.2)
    assert (config.algorithm.learning_rate, config.run.workers, config.schedule.steps) == (5e-3, 2, 7)
    assert config.run.technique == "ps-dqn"


def test_variety_is_there_where_it_was_asked_for(tmp_path):
    plain, mixed = run_config(), run_config(arenas=["paper"], team_sizes=[1, 2])
    assert plain.variety is None
    assert "variety" not in plain.model_dump(exclude_none=True)
    assert mixed.variety == VarietyConfig(arenas=("paper",), team_sizes=(1, 2))
    assert plain.with_options(variety=mixed.variety) == mixed
    write_config(mixed, tmp_path / "config.toml")
    assert read_config(tmp_path / "config.toml") == mixed


@pytest.mark.parametrize(
    ("technique", "options", "sentence"),
    [
        ("iql", {}, 'parameters must be "shared" with arenas or random_arenas: one network drives all.'),
        *(
            (
                technique,
                {},
                (
                    f'algorithm is "{algorithm}", which learns from the whole team at once, but must be one '
                    "whose robots learn each by itself with arenas or random_arenas."
                ),
            )
            for technique, algorithm in (
                ("qmix", "qmix"),
                ("vdn", "qmix"),
                ("ps-mappo", "ppo"),
                ("pqn-vdn", "pqn"),
                ("madqn", "madqn"),
                ("maa2c", "maa2c"),
                ("maddpg", "maddpg"),
            )
        ),
        ("ps-dqn", {"num_envs": 7}, "num_envs is 7, but must be a multiple of envs_per_arena, 2."),
        ("ps-a2c", {"workers": 2}, "workers is 2, but must be 1 with arenas or random_arenas."),
        (
            "ps-dqn",
            {"team_sizes": [0]},
            "variety.team_sizes is 0, but must be a list of 1 to 1000 whole numbers from 1 to 1000.",
        ),
    ],
)
def test_what_does_not_go_with_variety_is_one_sentence(technique, options, sentence):
    with pytest.raises(InputError) as caught:
        run_config(technique, arenas=["paper"], **options)
    assert str(caught.value) == sentence


def test_techniques_are_what_the_paper_and_we_say():
    facts = {}
    for name in TECHNIQUES:
        config = run_config(name)
        reward = config.env.reward
        facts[name] = (
            config.algorithm.name,
            reward.kind,
            reward.signed_distance,
            reward.idle_cost,
            config.env.stigmergy,
            config.schedule.curriculum,
            getattr(config.algorithm, "parameters", None),
            getattr(config.algorithm, "mask", False),
        )
    assert facts == {
        "iql": ("dqn", "local", False, False, False, False, "own", False),
        "iql+g": ("dqn", "global", False, False, False, False, "own", False),
        "iql+gs": ("dqn", "global", False, False, True, False, "own", False),
        "smadrl": ("dqn", "global", False, False, True, True, "own", False),
        "smadrl+": ("dqn", "global", True, True, True, True, "own", True),
        "ia2c": ("ia2c", "local", False, False, False, False, "own", False),
        "maa2c": ("maa2c", "global", False, False, False, False, None, False),
        "mappo": ("ppo", "global", False, False, False, False, "own", False),
        "ippo": ("ppo", "local", False, False, False, False, "own", False),
        "maddpg": ("maddpg", "global", False, False, False, False, None, False),
        "iql+s": ("dqn", "local", True, False, True, False, "own", False),
        "iql+sc": ("dqn", "local", True, False, True, True, "own", False),
        "ps-dqn": ("dqn", "local", True, True, True, False, "shared", True),
        "madqn": ("madqn", "global", False, False, False, False, None, False),
        "vdn": ("qmix", "global", False, False, False, False, "shared", False),
        "qmix": ("qmix", "global", False, False, False, False, "shared", False),
        "pqn": ("pqn", "local", False, False, False, False, "own", False),
        "pqn-vdn": ("pqn", "global", False, False, False, False, "own", False),
        "ps-pqn": ("pqn", "local", True, True, True, False, "shared", True),
        "ps-a2c": ("ia2c", "local", True, True, True, False, "shared", True),
        "ps-ippo": ("ppo", "local", True, True, True, False, "shared", True),
        "ps-ippo+": ("ppo", "local", True, True, True, False, "shared", True),
        "ps-mappo": ("ppo", "local", True, True, True, False, "shared", True),
    }
    critics = {name: getattr(run_config(name).algorithm, "critic", None) for name in TECHNIQUES}
    assert {name: critic for name, critic in critics.items() if critic} == {
        "mappo": "team",
        "ippo": "own",
        "ps-ippo": "own",
        "ps-ippo+": "own",
        "ps-mappo": "team",
    }
    assert [
        name for name in TECHNIQUES if getattr(run_config(name).algorithm, "normalisation", "") == "rms"
    ] == ["smadrl+", "ps-dqn"]
    team = {name for name in TECHNIQUES if run_config(name).env.reward.kind == "global"}
    assert {run_config(name).env.reward.sharing for name in team} == {"split"}
    assert find_technique("iql+gsc").name == "smadrl"


def test_a_technique_is_one_line_from_another():
    less = find_technique("ps-dqn").changed("ps-dqn without idle_cost", idle_cost=False)
    assert isinstance(less, Technique)
    assert less.options == find_technique("ps-dqn").options | {"idle_cost": False}
