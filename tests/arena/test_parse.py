import tomllib

import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from robosim.arena import arena_names, load_arena, parse_arena
from robosim.errors import InputError
from tests.strategies.arenas import arena_or_none, arena_texts, damaged_texts

GOOD = '''name = "small"
cell_size = 0.15
map = """
##########
#HH....SS#
#HH####SS#
#HHTTTTSS#
##########
"""

[robot]
mass = 0.4

[pellets]
count = 20

[timing]
substeps = 6

[start]
poses = []

[randomisation]
traction = [0.9, 1.1]
'''


def refusal(text: str) -> list[str]:
    with pytest.raises(InputError) as caught:
        parse_arena(text, "a.toml")
    return str(caught.value).split("\n")


def test_the_good_file_is_good() -> None:
    arena = parse_arena(GOOD, "a.toml")
    assert (arena.name, arena.rows, arena.columns, arena.tunnel_length) == ("small", 5, 10, 4)
    assert arena.randomisation.traction == (0.9, 1.1)
    assert arena.text == GOOD


FACTORS = "two factors [low, high], each a number from 0.1 to 10"
POSES = "at most 500 poses [x m, y m, heading rad], three numbers each"
MISTAKES = [
    # values
    ("mass = 0.4", "mass = -1", "robot.mass is -1, but must be a number from 0.01 to 100 kg."),
    ("mass = 0.4", "mass = nan", "robot.mass is nan, but must be a number from 0.01 to 100 kg."),
    ("mass = 0.4", "mass = inf", "robot.mass is inf, but must be a number from 0.01 to 100 kg."),
    ("mass = 0.4", 'mass = "0.4"', 'robot.mass is "0.4", but must be a number from 0.01 to 100 kg.'),
    ("mass = 0.4", "mass = true", "robot.mass is true, but must be a number from 0.01 to 100 kg."),
    ("mass = 0.4", "mas = 0.4", "robot.mas is not a key of an arena file: did you mean mass?"),
    ("mass = 0.4", 'shape = "ball"', 'robot.shape is "ball", but must be "circle", "capsule" or "box".'),
    ("count = 20", "count = 20.0", "pellets.count is 20.0, but must be a whole number from 1 to 2000."),
    ("count = 20", "count = 0", "pellets.count is 0, but must be a whole number from 1 to 2000."),
    (
        "count = 20",
        f"count = {'9' * 40}",
        "pellets.count is a whole number of more than 30 digits, but must be a whole number from 1 to 2000.",
    ),
    ("substeps = 6", "substeps = 0", "timing.substeps is 0, but must be a whole number from 1 to 200."),
    ("[0.9, 1.1]", "[0.0, 20]", f"randomisation.traction is [0.0, 20], but must be {FACTORS}."),
    ("[0.9, 1.1]", "1.0", f"randomisation.traction is 1.0, but must be {FACTORS}."),
    (
        "[0.9, 1.1]",
        "[1.1, 0.9]",
        "randomisation.traction is [1.1, 0.9], but the first must be at most the second.",
    ),
    ("poses = []", "poses = [[1, 2]]", f"start.poses is [[1, 2]], but must be {POSES}."),
    ("poses = []", 'zone = "wall"', 'start.zone is "wall", but must be "home", "floor" or "tunnel".'),
    ("[timing]", "[tuming]", "tuming is not a key of an arena file: did you mean timing?"),
    ("cell_size = 0.15", "", "cell_size is missing; it must be a number from 0.01 to 2 m."),
    (
        "cell_size = 0.15",
        "cell_size = 0.15\nrobots = 3",
        "robots is not a key of an arena file: did you mean robot or groups?",
    ),
    (
        'name = "small"',
        "name = 3",
        "name is 3, but must be 1 to 60 letters, digits, spaces, dots, dashes or underscores.",
    ),
    (
        'name = "small"',
        'name = "small"\ndescription = "\\u001b[31m"',
        'description is "\\u001b[31m", but must be at most 2000 printable characters.',
    ),
    # map
    (
        "TTTT",
        "TxTT",
        (
            'map row 4, column 5 is "x", but must be # (wall), . (floor), H (home), S (source), T (tunnel) '
            "or X (hand-over)."
        ),
    ),
    ("#HH....SS#", "#HH....SS", "map row 2 has 9 cells, but row 1 has 10; all must have as many."),
    ("####SS#", "####SS.", "map has a hole in its border at row 3, column 10; it must be # there."),
    (
        "##########\n#HH",
        "##......##\n#HH",
        "map has a hole in its border at row 1, column 3 (and at 5 more cells); it must be # there.",
    ),
    ("H", ".", "map has no home (H) cell, but needs at least one."),
    ("S", ".", "map has no source (S) cell, but needs at least one."),
    (
        "#HH....SS#\n#HH####SS#\n#HHTTTTSS#",
        "#HH..##SS#\n#HH####SS#\n#HHTT##SS#",
        "map has no path from home (H) to the source (S); free cells must join them edge to edge.",
    ),
    (
        "#HH....SS#\n#HH####SS#",
        "#HH.###S##\n#HH#####S#",
        (
            "map row 2, column 8 is source (S), but is cut off by walls; all home, source and hand-over "
            "cells must be joined by free cells."
        ),
    ),
    # what must go together
    ("mass = 0.4", "width = 0.1", "robot.width is 0.1, but must equal robot.length (0.11) of a circle."),
    (
        "mass = 0.4",
        'shape = "box"\nwidth = 0.12',
        "robot.width is 0.12, but must be at most robot.length (0.11).",
    ),
    (
        "mass = 0.4",
        "width = 0.15\nlength = 0.15",
        (
            "robot.width is 0.15, but must be less than 0.15 m, the width of the widest path from home to "
            "the source."
        ),
    ),
    (
        "mass = 0.4",
        'shape = "capsule"\nlength = 0.5',
        'start.zone is "home", but that zone has no room for a robot that turns within 0.5 m.',
    ),
    (
        "substeps = 6",
        "substeps = 1",
        (
            "timing.control_period / timing.substeps is 0.1 s, but must be at most 0.025 s, in which a robot "
            "drives pellets.radius / 4 at its top speed (0.2 m/s)."
        ),
    ),
    (
        "mass = 0.4",
        "wheel_base = 0.01",
        (
            "timing.control_period / timing.substeps is 0.01667 s, but must be at most 0.00625 s, in which a "
            "robot turns 0.25 rad at its top rate (40 rad/s)."
        ),
    ),
    (
        "substeps = 6",
        "control_period = 0.07",
        "timing.decision_period is 0.3, but must be a whole multiple of timing.control_period (0.07).",
    ),
    (
        "substeps = 6",
        "decision_period = 10.0\nsubsteps = 60",
        "timing.substeps is 60, but may be at most 50: a decision may have at most 5000 substeps.",
    ),
    (
        "count = 20",
        "count = 2000",
        (
            "pellets.count is 2000, but must be at most 40: the source (S) has no room for more pellets of "
            "radius 0.02 m."
        ),
    ),
    (
        "poses = []",
        "poses = [[0.3, 0.4, 0.0], [0.3, 0.5, 1.0]]",
        "start.poses[1] is [0.3, 0.5, 1.0], but there the robot touches that of start.poses[0].",
    ),
    (
        "poses = []",
        "poses = [[0.2, 0.4, 0.0]]",
        "start.poses[0] is [0.2, 0.4, 0.0], but there the robot touches a wall.",
    ),
    (
        "poses = []",
        "poses = [[900.0, -900, 0]]",
        "start.poses[0] is [900.0, -900.0, 0.0], but there the robot touches a wall.",
    ),
]


@pytest.mark.parametrize(("good", "bad", "sentence"), MISTAKES)
def test_one_mistake_is_one_sentence(good: str, bad: str, sentence: str) -> None:
    assert good in GOOD
    assert refusal(GOOD.replace(good, bad)) == [f"a.toml: {sentence}"]


def test_a_pose_in_a_room_without_a_door_is_refused() -> None:
    text = GOOD.replace("#HH....SS#\n#HH####SS#", "#HH####SS#\n#HH#..#SS#").replace(
        "#HHTTTTSS#", "#HH####SS#\n#HHTTTTSS#"
    )
    assert refusal(text.replace("poses = []", "poses = [[0.675, 0.525, 0.0]]")) == [
        (
            "a.toml: start.poses[0] is [0.675, 0.525, 0.0], but there the robot has no path to home "
            "and source that is wide enough."
        )
    ]


def test_several_mistakes_are_reported_together() -> None:
    text = (
        GOOD.replace("mass = 0.4", "mas = 1\nlength = 9")
        .replace("TTTT", "TTxT")
        .replace("count = 20", "count = 0")
    )
    assert refusal(text) == [
        "a.toml: robot.length is 9, but must be a number from 0.01 to 2 m.",
        "a.toml: robot.mas is not a key of an arena file: did you mean mass?",
        "a.toml: pellets.count is 0, but must be a whole number from 1 to 2000.",
        (
            'a.toml: map row 4, column 6 is "x", but must be # (wall), . (floor), H (home), S (source), '
            "T (tunnel) or X (hand-over)."
        ),
    ]


def test_what_does_not_go_together_is_reported_together() -> None:
    text = (
        GOOD.replace("substeps = 6", "substeps = 1")
        .replace("[0.9, 1.1]", "[2, 1]")
        .replace("count = 20", "count = 70")
    )
    assert [sentence.split()[1] for sentence in refusal(text)] == [
        "randomisation.traction",
        "timing.control_period",
        "pellets.count",
    ]


def test_a_big_map_is_refused() -> None:
    rows = ["#" * 201, *["#HS" + "." * 197 + "#"] * 3, "#" * 201]
    text = GOOD[: GOOD.index("####")] + "\n".join(rows) + '\n"""\n'
    assert refusal(text) == [
        "a.toml: map has 5 rows and up to 201 columns, but may have at most 200 of each."
    ]


@pytest.mark.parametrize(
    "text", ["[[[", "a = ", "x" * 1000, "[" * 100_000, "a = " + "[" * 5000, f"a = {'9' * 9000}"]
)
def test_what_is_not_toml_is_refused(text: str) -> None:
    (sentence,) = refusal(text)
    assert sentence.startswith("a.toml: not a TOML file (")


def test_a_decision_that_would_take_seconds_is_refused() -> None:
    before = "count = 20\n\n[timing]\nsubsteps = 6"
    after = "count = 201\n\n[timing]\ndecision_period = 10.0\nsubsteps = 50"
    assert refusal(GOOD.replace(before, after))[0] == (
        "a.toml: pellets.count is 201, but may be at most 200 where a decision has 5000 substeps: "
        "it would take too long."
    )


def test_windows_line_ends_make_no_difference() -> None:
    assert (parse_arena(GOOD.replace("\n", "\r\n"), "a").zones == parse_arena(GOOD, "a").zones).all()


@pytest.mark.parametrize("name", arena_names())
def test_shipped_arenas_load_and_bear_their_name(name: str) -> None:
    arena = load_arena(name)
    assert arena.name == name
    assert arena.description
    assert arena.capacity >= 16


def test_paper_holds_32_robots() -> None:
    assert load_arena("paper").capacity >= 32


def test_robotarium_has_the_real_floor() -> None:
    arena = load_arena("robotarium")
    inner = ((arena.columns - 2) * arena.cell_size, (arena.rows - 2) * arena.cell_size)
    assert inner == pytest.approx((3.2, 2.0))


@settings(max_examples=60)
@given(arena_texts())
def test_a_drawn_file_loads_or_is_refused(text: str) -> None:
    arena_or_none(text)


@settings(max_examples=150)
@given(damaged_texts())
def test_a_damaged_file_loads_or_is_refused(text: str) -> None:
    arena_or_none(text)


RELAY = load_arena("relay").text
GROUP_MISTAKES = [
    (
        'role = "excavator"',
        'role = "digger"',
        'groups[0].role is "digger", but must be "all-round", "excavator" or "transporter".',
    ),
    ('role = "excavator"', "count = 0", "groups[0].count is 0, but must be a whole number from 1 to 100."),
    (
        'name = "excavators"',
        "",
        "groups[0].name is missing; it must be 1 to 60 letters, digits, spaces, dashes or underscores.",
    ),
    (
        'name = "excavators"',
        'name = "transporters"',
        'groups[1].name is "transporters", but must differ from that of groups[0].',
    ),
    (
        "grip_force = 4.0",
        "grip_force = -1",
        "groups[0].robot.grip_force is -1, but must be a number from 0.001 to 1000 N.",
    ),
    (
        "grip_force = 4.0",
        "grip = 1",
        "groups[0].robot.grip is not a key of an arena file: did you mean grip_force or gripper_reach?",
    ),
    (
        "length = 0.09",
        "length = 0.1",
        "groups[0].robot.width is 0.09, but must equal groups[0].robot.length (0.1) of a circle.",
    ),
    (
        "length = 0.09\nwidth = 0.09",
        "length = 0.32\nwidth = 0.32",
        (
            "groups[0].robot.width is 0.32, but must be less than 0.3 m, the width of the widest path from "
            "the hand-over to the source."
        ),
    ),
    (
        'role = "transporter"',
        'role = "excavator"',
        (
            'groups[1].role is "excavator", but no group has the role "transporter", which brings home what '
            "is handed over."
        ),
    ),
    (
        'role = "excavator"',
        'role = "all-round"',
        'groups[1].role is "transporter", but no group has the role "excavator", which hands over.',
    ),
    (
        "X",
        ".",
        (
            'groups[0].role is "excavator", but the map has no hand-over (X) cell where it could meet the '
            "others."
        ),
    ),
    (
        "max_wheel_speed = 25.0",
        "max_wheel_speed = 250.0",
        (
            "timing.control_period / timing.substeps is 0.008333 s, but must be at most 0.00125 s, in which "
            "a robot drives pellets.radius / 4 at its top speed (4 m/s)."
        ),
    ),
]


@pytest.mark.parametrize(("good", "bad", "sentence"), GROUP_MISTAKES)
def test_one_mistake_in_groups_is_one_sentence(good: str, bad: str, sentence: str) -> None:
    assert good in RELAY
    assert refusal(RELAY.replace(good, bad)) == [f"a.toml: {sentence}"]


@pytest.mark.parametrize(
    ("groups", "sentence"),
    [
        ("groups = 3", "groups is 3, but must be 2 to 8 tables [[groups]]."),
        ('groups = [{name = "a"}]', "groups is [a table], but must be 2 to 8 tables [[groups]]."),
        ("groups = [1, 2]", "groups[0] is 1, but must be a table."),
    ],
)
def test_groups_are_two_tables_or_more(groups: str, sentence: str) -> None:
    assert refusal(f"{groups}\n{GOOD}")[0] == f"a.toml: {sentence}"


def test_groups_differ_from_the_robot_in_what_they_say() -> None:
    arena = parse_arena(RELAY, "a.toml")
    excavators, transporters = arena.groups
    assert (excavators.sheet.length, excavators.sheet.grip_force) == (0.09, 4.0)
    assert (transporters.sheet.length, transporters.sheet.max_wheel_speed) == (0.11, 25.0)
    assert excavators.sheet.mass == transporters.sheet.mass == arena.robot.mass
    assert arena.handover is not None
    assert arena.handover.raster.shape[-1] == 1


_VALUES = st.one_of(
    st.integers(-3, 300),
    st.floats(allow_nan=True),
    st.text(max_size=4),
    st.booleans(),
    st.lists(st.integers(0, 3), max_size=2),
)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.dictionaries(st.sampled_from(["name", "role", "count", "robot", "nmae"]), _VALUES, max_size=5),
        max_size=3,
    )
)
def test_whatever_groups_hold_they_are_groups_or_sentences(groups: list[dict[str, object]]) -> None:
    text = tomli_w.dumps({"groups": groups, **tomllib.loads(GOOD)})
    arena = arena_or_none(text)
    assert arena is None or len(arena.groups) == len(groups)
