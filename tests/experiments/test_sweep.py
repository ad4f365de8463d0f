import itertools
import re
import shutil
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.arena import load_arena
from robosim.control.policy import find_policy, load_policy, save_policy
from robosim.errors import InputError
from robosim.experiments.sweep import read_sweep
from robosim.experiments.team import Measuring, learning_job
from robosim.learning.config import run_config

WHOLE = """
about = "All that a file may hold."
[options]
world = "grid"
steps = 1000
[vary]
technique = ["iql", "smadrl", "lanes", "policy:paper-2"]
robots = [2, 3]
seed = [0, 1]
[[where]]
match = { technique = "smadrl", robots = [3, 2] }
options = { steps = 2000, first_team = 1 }
[[where]]
match = { technique = "smadrl", robots = 3 }
options = { steps = 3000, temperature = 0.5 }
[[where]]
match = { technique = "iql", seed = 1 }
trials = [ { learning_rate = 1e-3 }, { learning_rate = 3e-4, hidden = [8, 8] } ]
[[where]]
match = { technique = "policy:paper-2", robots = 3 }
skip = "it drives two"
[evaluation]
episodes = 2
steps = 50
"""
TWENTY = ", ".join(f"{{steps = {number}}}" for number in range(1, 21))
TWICE_WITHOUT = (
    "this is stigmergy=false pheromone_decay=0.1 once more, since pheromone_decay changes nothing without "
    "stigmergy: give it with [[where]] to the runs that it is for."
)
TWICE_THERE = (
    "this is hyper_width=8 once more, since hyper_width changes nothing there (a sum of values has no "
    "networks): give it with [[where]] to the runs that it is for."
)
UNMATCHED = """
[vary]
robots = [2, 3]
[[where]]
match = { robots = 2 }
options = { seed = 5 }
[[where]]
match = { robots = 3, seed = 5 }
skip = "each has one of them, none has both"
"""


def read(tmp_path, text):
    path = tmp_path / "sweep.toml"
    path.write_text(text)
    return read_sweep(path)


def config_of(run):
    return run.job.config


def test_every_combination_is_a_run_and_the_last_name_varies_fastest(tmp_path):
    sweep = read(tmp_path, WHOLE)
    labels = [run.label for run in sweep.runs]
    plain = itertools.product(("iql", "smadrl", "lanes", "policy:paper-2"), (2, 3), (0, 1))
    expected = []
    for technique, robots, seed in plain:
        label = f"technique={technique} robots={robots} seed={seed}"
        trials = (" learning_rate=0.001", " learning_rate=0.0003 hidden=[8, 8]")
        expected += [label + trial for trial in (trials if (technique, seed) == ("iql", 1) else ("",))]
    assert labels == expected
    assert [run.skip for run in sweep.runs if run.job is None] == ["it drives two"] * 2
    assert len({job.key for job in sweep.jobs}) == len(sweep.jobs) == len(sweep.runs) - 2


def test_a_run_is_what_the_same_options_make_of_run_config(tmp_path):
    runs = {run.label: run for run in read(tmp_path, WHOLE).runs}
    measuring = Measuring(episodes=2, steps=50)
    for label, technique, options in (
        ("technique=iql robots=2 seed=0", "iql", {"steps": 1000}),
        ("technique=smadrl robots=2 seed=1", "smadrl", {"steps": 2000, "first_team": 1, "seed": 1}),
        # The later block wins, and what it does not name stays.
        (
            "technique=smadrl robots=3 seed=0",
            "smadrl",
            {"steps": 3000, "first_team": 1, "robots": 3, "temperature": 0.5},
        ),
        (
            "technique=iql robots=3 seed=1 learning_rate=0.0003 hidden=[8, 8]",
            "iql",
            {"steps": 1000, "robots": 3, "seed": 1, "learning_rate": 3e-4, "hidden": (8, 8)},
        ),
    ):
        config = run_config(technique, **{"world": "grid", "robots": 2, "seed": 0, **options})
        assert runs[label].job.key == learning_job(config, measuring).key


def test_teams_that_do_not_learn_take_of_the_options_what_concerns_them(tmp_path):
    runs = {run.label: run for run in read(tmp_path, WHOLE).runs}
    lanes = config_of(runs["technique=lanes robots=3 seed=1"])
    assert lanes["run"] == {"technique": "lanes", "seed": 1}
    assert (lanes["env"]["world"], lanes["env"]["robots"]) == ("grid", 3)
    assert (lanes["env"]["pellet_gradient"], lanes["env"]["episode_steps"]) == (0.0, 0)
    assert "algorithm" not in lanes
    policy = config_of(runs["technique=policy:paper-2 robots=2 seed=0"])
    assert (policy["env"]["world"], policy["env"]["arena"]) == ("grid", "paper")
    # However long the others learn, it is the same measurement, and it is done once.
    text = '[vary]\nsteps = [100, 200]\ntechnique = ["iql", "lanes"]\nepsilon_start = [0.5, 0.6]'
    labels = [run.label for run in read(tmp_path, text).runs]
    assert len(labels) == 5
    assert sum("lanes" in label for label in labels) == 1


def test_an_arena_of_ones_own_is_part_of_the_run(tmp_path):
    arena = tmp_path / "own.toml"
    text = load_arena("single-lane").text
    arena.write_text(text)
    options = f'[options]\narena = "{arena}"\n'
    before = read(tmp_path, options).jobs[0]
    assert before.config["env"]["arena"] == text
    arena.write_text(text + "\n# changed\n")
    assert read(tmp_path, options).jobs[0].key != before.key
    shipped = read(tmp_path, '[options]\narena = "single-lane"\n').jobs[0]
    assert shipped.config["env"]["arena"] == "single-lane"


def test_the_file_in_the_docs_is_one(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "sweeps.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"```toml\n(.*?)```", page, flags=re.DOTALL)
    sweep = read(tmp_path, text)
    assert len(sweep.runs) == 4 * 4 * 3 + 4 * 3
    assert sum(bool(run.skip) for run in sweep.runs) == 3


def dumped(table):
    return "".join(f"{name} = {value}\n" for name, value in table)


@given(order=st.permutations(["world", "steps", "robots", "hidden", "learning_rate"]))
def test_a_run_is_known_by_what_it_is_and_not_by_how_its_file_is_written(order, tmp_path_factory):
    values = {"world": '"grid"', "steps": "1000", "robots": "3", "hidden": "[8]", "learning_rate": "0.001"}
    for split in (0, 2, 5):
        options = dumped((name, values[name]) for name in order[:split])
        vary = dumped((name, f"[{values[name]}]") for name in order[split:])
        text = f"[options]\n{options}[vary]\n{vary}"
        (job,) = read(tmp_path_factory.mktemp("sweep"), text).jobs
        config = run_config("ps-dqn", world="grid", steps=1000, robots=3, hidden=(8,), learning_rate=1e-3)
        assert job.key == learning_job(config, Measuring()).key


def test_keys_do_not_change_when_an_optional_part_is_left_out():
    config = learning_job(run_config("iql"), Measuring()).config
    assert set(config) == {"env", "algorithm", "schedule", "run", "evaluation"}

    def leaves(value):
        if isinstance(value, dict):
            for inner in value.values():
                yield from leaves(inner)
        else:
            yield value

    assert None not in list(leaves(config))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("[vary", "not a TOML file ("),
        ("colour = 1", '"colour" is not an option: '),
        ("about = 3", "about is 3, but must be a text of at most 2000 characters."),
        ("[vary]\nrobots = 3", "vary.robots is 3, but must be a list of 1 to 1000 values."),
        ("[vary]\nrobots = []", "vary.robots is [], but must be a list of 1 to 1000 values."),
        ("[vary]\nrobots = [2, 3, 2]", "vary.robots has 2 twice."),
        (
            "[options]\nrobots = { a = 1 }",
            "options.robots is a table, but must be a number, a text, true or false, or a list of them.",
        ),
        (
            "[vary]\nrobots = [[[1]]]",
            "vary.robots is [[1]], but must be a number, a text, true or false, or a list of them.",
        ),
        (
            "[vary]\nseed = [0, 1]\nrobots = [2, 3, 4000]",
            "seed=0 robots=4000: env.robots is 4000, but must be a whole number from 1 to 1000.",
        ),
        (
            '[vary]\ntechnique = ["iql", "smadlr"]',
            'technique=smadlr: unknown technique "smadlr": did you mean smadrl',
        ),
        (
            '[options]\ntechnique = "lane"',
            'options: unknown technique "lane": did you mean lanes',
        ),
        ("[options]\ntechnique = 3", "options: technique is 3, but must be a text."),
        (
            "[options]\nlearning_rat = 1",
            'options: "learning_rat" is not an option: did you mean learning_rate',
        ),
        (
            '[options]\ntechnique = "lanes"\nlearning_rat = 1',
            'options: "learning_rat" is not an option: did you mean learning_rate',
        ),
        ("[options]\nsteps = nan", "options: schedule.steps is nan, but must be a whole number from 1 to "),
        (
            "[options]\nworkers = 2",
            "options.workers cannot be given: a sweep runs each team in one process of its own.",
        ),
        (
            "[vary]\nevaluation_steps = [2]",
            "vary.evaluation_steps cannot be given: [evaluation] says how teams are measured.",
        ),
        (
            "[evaluation]\nepisodes = 0",
            "evaluation.episodes is 0, but must be a whole number from 1 to 1000.",
        ),
        ("[[where]]\nskip = 'no'", "where 1: match is missing; it must be a table of at most 100 entries."),
        ("[[where]]\nmatch = {}", "where 1: there must be options, trials or skip."),
        (
            "[[where]]\nmatch = {}\nskip = 'no'\n[[where]]\nmatch = {}\nskip = 'no'\noptions = {steps = 1}",
            "where 2: skip says that these runs are not run, so there must be neither options nor trials.",
        ),
        (
            "[vary]\nrobots = [2, 3]\n[[where]]\nmatch = {robot = 2}\nskip = 'no'",
            "where 1: match.robot is in no run: did you mean robots?",
        ),
        (
            "[vary]\ntechnique = ['iql', 'smadrl']\n[[where]]\nmatch = {technique = 'smadlr'}\nskip = 'no'",
            'where 1: match.technique is "smadlr" in no run: did you mean smadrl',
        ),
        (
            "[vary]\nrobots = [2]\nseed = [0, 1]\n[[where]]\nmatch = {robots = true}\nskip = 'no'",
            "where 1: match.robots is true in no run: known names are 2.",
        ),
        (
            UNMATCHED,
            "where 2: no run matches.",
        ),
        (
            "[[where]]\nmatch = {}\ntrials = [{workers = 2}]",
            "where 1: trials.workers cannot be given: a sweep runs each team in one process of its own.",
        ),
        (
            f"[vary]\nseed = {list(range(200))}\nrobots = {list(range(1, 101))}",
            "vary: these are 20000 runs, but there must be at most 10000.",
        ),
        (
            f"[vary]\nseed = {list(range(900))}\n[[where]]\nmatch = {{}}\ntrials = [{TWENTY}]",
            "where 1: these are 18000 runs, but there must be at most 10000.",
        ),
        (
            '[options]\ntechnique = "policy:paper-200"',
            "options: no policy is named 'paper-200', and there is no such folder: did you mean ",
        ),
        (
            '[options]\ntechnique = "policy:"',
            'options: technique is "policy:", but must be policy: and the name or the folder of a policy.',
        ),
        (
            '[options]\ntechnique = "policy:paper-8"\n[vary]\nactions = ["cardinal", "wheels"]',
            'actions=wheels: actions is "wheels", but must be "cardinal": "policy:paper-8" was trained so.',
        ),
        (
            '[options]\ntechnique = "policy:paper-8"\nkeep_distance = 0.3',
            'options: keep_distance is 0.3, but must be absent: "policy:paper-8" was trained so.',
        ),
        (
            '[options]\ntechnique = "policy:paper-8"\ntemperature = 0.3',
            'options: temperature is 0.3, but must be absent: "policy:paper-8" was trained so.',
        ),
        ('[options]\nstart_from = "nosuch"', "options: start_from: no policy is named 'nosuch', and "),
        (
            '[evaluation]\nprofile = "nosuch"',
            "evaluation.profile: No profile is named 'nosuch': did you mean none?",
        ),
        ("where = 3", "where is 3, but must be a list of 0 to 1000 tables."),
        ("where = [3]", "where 1 is 3, but must be a table."),
        (
            "[[where]]\nmatch = {}\ntrials = [{steps = 1, seed = 2}, {seed = 2, steps = 1}]",
            "where 1: trials has seed=2 steps=1 twice.",
        ),
        ("[[where]]\nmatch = {}\ntrials = [{}, {}]", "where 1: trials has an empty table twice."),
        (
            '[options]\nrobots = 25\nworld = "grid"',
            "options: robots is 25, but must be a whole number from 1 to 24, the room in arena 'paper'.",
        ),
        ('[options]\ntechnique = "lanes"\nrobots = 999', "options: robots is 999, but must be "),
        ('[options]\narena = "papr"', "options: No arena is named 'papr': did you mean paper"),
        (
            '[options]\ntechnique = "active"\nactions = "wheels"',
            "options: active: drives by cardinal actions only, and the environment's ",
        ),
        ('[options]\nextra_reward = "nosuch"', 'options: unknown extra reward "nosuch": '),
        (
            '[options]\ndevice = "gpu"',
            'options: device is "gpu", but must be "cpu", or "cuda" for a GPU.',
        ),
        (
            '[options]\nstart_from = "paper-2"\nstigmergy = false',
            "options: policy paper-2 does not fit arena 'paper': stigmergy was True in training and ",
        ),
        (
            '[options]\nrobots = 8\nstart_from = "paper-8-smadrl"\ntechnique = "smadrl+"\nfine_tune = 0.0',
            "options: start_from holds 8 robots, but must hold less than the whole team without fine_tune.",
        ),
        (
            '[options]\nworld = "grid"\nprofile = "robotarium"',
            "options: motion.wheel_gain is [0.97, 1.03], but must be [1.0, 1.0] in the grid world, ",
        ),
        (
            '[options]\nworld = "grid"\n[evaluation]\nprofile = "robotarium"',
            "options: motion.wheel_gain is [0.97, 1.03], but must be [1.0, 1.0] in the grid world, ",
        ),
        (
            '[options]\ntechnique = "ps-dqn"\narenas = ["paper"]\nteam_sizes = [40]',
            "options: arenas: paper has room for 35 robots, but must have room for 40, as team_sizes says.",
        ),
        (
            '[options]\ntechnique = "iql"\n[[where]]\nmatch = {}\ntrials = [{}, {fine_tune = 0.2}]',
            "fine_tune=0.2: this is technique=iql once more, since fine_tune changes nothing without ",
        ),
        (
            '[options]\ntechnique = "policy:paper-2"\narena = "robotarium"',
            "options: policy paper-2 does not fit arena 'robotarium': cell size (m) was 0.15 in ",
        ),
        (
            "[vary]\nstigmergy = [true, false]\npheromone_decay = [0.1, 0.2]",
            f"stigmergy=false pheromone_decay=0.2: {TWICE_WITHOUT}",
        ),
        (
            '[options]\ntechnique = "vdn"\n[vary]\nhyper_width = [8, 16]',
            f"hyper_width=16: {TWICE_THERE}",
        ),
    ],
)  # fmt: skip
def test_a_mistake_is_a_sentence(tmp_path, text, sentence):
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    said = str(caught.value)
    assert said.startswith(f"{tmp_path / 'sweep.toml'}: {sentence}")
    assert "\n" not in said
    if sentence.endswith((".", "?")):
        assert said == f"{tmp_path / 'sweep.toml'}: {sentence}"


@pytest.mark.parametrize("technique", ["lanes", "policy:paper-8"])
@pytest.mark.parametrize(
    ("option", "sentence"),
    [
        ("learning_rate = nan", "algorithm: learning_rate is nan, but must be a number from 1e-08 to 1."),
        ("learning_rate = -3", "algorithm: learning_rate is -3, but must be a number from 1e-08 to 1."),
        ("entropy_weight = 'x'", 'algorithm: entropy_weight is "x", but must be a number from 0 to 100.'),
        (
            "mixer = 'x'",
            'algorithm: mixer is "x", but must be "none" or "sum" (pqn), or "sum" or "monotonic" (qmix).',
        ),
        ("steps = 'many'", 'schedule.steps is "many", but must be a whole number from 1 to 10000000000.'),
        ("num_envs = 'x'", 'schedule.num_envs is "x", but must be a whole number from 1 to 4096.'),
        ("seed = -1", "run.seed is -1, but must be a whole number from 0 to 9223372036854775807."),
        ("sensing_dropout = 2", "env.profile.sensing.dropout is 2, but must be a number from 0 to 1."),
        ("profile = 'nosuch'", "No profile is named 'nosuch': did you mean none?"),
        ("algorithm = 'x'", 'unknown algorithm "x": did you mean qmix?'),
        ("team_sizes = [0]", "variety.team_sizes is 0, but must be a list of 1 to 1000 whole numbers from"),
        ("arenas = ['nosuch']", "No arena is named 'nosuch': known names are"),
        ("start_from = 'nosuch'", "start_from: no policy is named 'nosuch', and there is no such folder: "),
    ],
)
def test_a_wrong_value_is_a_sentence_where_no_team_learns(tmp_path, technique, option, sentence):
    with pytest.raises(InputError) as caught:
        read(tmp_path, f'[options]\ntechnique = "{technique}"\n{option}\n')
    said = str(caught.value)
    assert said.startswith(f"{tmp_path / 'sweep.toml'}: options: {sentence}")
    if sentence.endswith((".", "?")):
        assert said == f"{tmp_path / 'sweep.toml'}: options: {sentence}"


def test_what_only_learners_take_is_nothing_to_teams_that_do_not_learn(tmp_path):
    options = (
        "learning_rate = 0.001\nentropy_weight = 0.1\nmixer = 'sum'\ncurriculum = true\nfirst_share = 0.5\n"
        "profile = 'harsh'\nreward = 'local'\nstart_from = 'paper-2'\nactions = 'cardinal'\n"
    )
    for technique in ("lanes", "policy:paper-8"):
        bare, full = (
            read(tmp_path, f'[options]\ntechnique = "{technique}"\n{more}').jobs[0]
            for more in ("actions = 'cardinal'\n", options)
        )
        if technique == "lanes":
            # The environment of one that learns nothing is kept as it is asked for.
            assert full.config["env"].pop("reward") != bare.config["env"].pop("reward")
        assert full.config == bare.config


def test_the_profile_under_which_a_finished_team_learned_is_no_part_of_measuring_it(tmp_path):
    # There is no such thing in the grid world.
    text = '[options]\nrobots = 4\ntechnique = "policy:paper-4-robust"\nworld = "grid"'
    (job,) = read(tmp_path, text).jobs
    assert "profile" not in job.config["env"]


def test_an_option_that_changes_nothing_is_no_mistake_where_it_makes_no_run_twice(tmp_path):
    text = "[options]\npheromone_decay = 0.2\nfirst_team = 3\n[vary]\nstigmergy = [true, false]\n"
    assert len(read(tmp_path, text).runs) == 2


def test_a_policy_to_start_from_counts_by_its_weights(tmp_path):
    start = tmp_path / "start"
    shutil.copytree(find_policy("paper-2"), start)
    text = f'[options]\ntechnique = "iql"\nstigmergy = true\nstart_from = "{start}"\n'
    (before,) = read(tmp_path, text).jobs
    assert list(before.config) == ["env", "algorithm", "schedule", "run", "evaluation", "start_weights"]
    assert read(tmp_path, text).jobs[0].key == before.key
    # Trained again, it is another team by the same name.
    policy = load_policy(start)
    weights = {name: array + 1.0 for name, array in policy.weights().items()}
    save_policy(start, weights, policy.card)
    (after,) = read(tmp_path, text).jobs
    assert after.config["start_weights"] != before.config["start_weights"]
    assert after.key != before.key
    (start / "policy.safetensors").unlink()
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    assert str(caught.value) == (
        f"{tmp_path / 'sweep.toml'}: options: start_from: "
        f"{start / 'policy.safetensors'}: there is no such weights file."
    )


def test_a_file_that_cannot_be_read_is_a_sentence(tmp_path):
    with pytest.raises(InputError) as caught:
        read_sweep(tmp_path / "none.toml")
    assert str(caught.value) == f"{tmp_path / 'none.toml'}: there is no such sweep file."
    (tmp_path / "large.toml").write_text("#" * 1_000_001)
    with pytest.raises(InputError, match="larger than 1000000 bytes, the most that a sweep file may have"):
        read_sweep(tmp_path / "large.toml")
    (tmp_path / "bytes.toml").write_bytes(b"\xff")
    with pytest.raises(InputError, match="byte 0 is not UTF-8"):
        read_sweep(tmp_path / "bytes.toml")


@given(text=st.text(alphabet='abc=[]{}"\n .1', max_size=40))
def test_no_text_is_more_than_a_sentence(text, tmp_path_factory):
    path = tmp_path_factory.mktemp("sweep") / "sweep.toml"
    path.write_text(text)
    try:
        tomllib.loads(text)
        read_sweep(path)
    except (InputError, tomllib.TOMLDecodeError):
        pass


def test_only_takes_the_runs_with_these_values(tmp_path):
    sweep = read(tmp_path, WHOLE)

    def labels(text):
        return [run.label for run in sweep.only(text).runs]

    assert labels("technique=lanes, robots=3") == [
        "technique=lanes robots=3 seed=0",
        "technique=lanes robots=3 seed=1",
    ]
    assert len(labels("technique=lanes,technique=smadrl,seed=0")) == 4
    # As in the file, whatever way a number is written; commas in lists part nothing.
    assert len(labels("learning_rate=1e-3")) == 2
    assert labels("learning_rate=0.00030, hidden=[8,8],seed=1") == labels("hidden=[8, 8]")
    assert len(labels("hidden=[8, 8]")) == 2
    assert labels('technique="lanes",robots = 3') == labels("technique=lanes, robots=3")
    # Options that all runs share are there to choose by as well.
    assert labels("world=grid") == [run.label for run in sweep.runs]
    for text, sentence in (
        ("lanes", '--only is "lanes", but must be NAME=VALUE, or several with commas.'),
        ("robot=2", '--only: "robot" is in no run: did you mean robots?'),
        ("", '--only is "", but must be NAME=VALUE, or several with commas.'),
        ("seed=0,,robots=2", '--only is "seed=0,,robots=2", but must be NAME=VALUE, or several with commas.'),
        ("hidden=[8]", '--only: no run has hidden "[8]": did you mean [8, 8]?'),
        ("seed=true", '--only: no run has seed "true": known names are 0, 1.'),
        ("robots=5", '--only: no run has robots "5": known names are 2, 3.'),
        ("technique=lane", '--only: no run has technique "lane": did you mean lanes?'),
        (
            "technique=lanes,steps=3000",
            '--only is "technique=lanes,steps=3000": every one of these values has runs, but none has all.',
        ),
    ):
        with pytest.raises(InputError) as caught:
            sweep.only(text)
        assert str(caught.value) == sentence
