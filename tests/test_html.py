"""What objects show in a notebook: well-formed, small, true, and harmless whatever their names are."""

import dataclasses
from html.parser import HTMLParser
from xml.etree import ElementTree as ET

import numpy as np
import pytest

import robosim
from robosim.arena import parse_arena
from robosim.arena.model import Zone
from robosim.arena.picture import ZONE_COLOURS, arena_svg, css
from robosim.control.card import Evaluation
from robosim.control.policy import Policy
from robosim.html import facts_html

HOSTILE = "<script>alert(1)</script>&\x1b[2J" + "x" * 2000


def cells_of(markup: str) -> dict[str, str]:
    """Name and value of every row; raises for markup that is not well-formed."""
    rows = ET.fromstring(markup).iter("tr")
    return {row[0].text or "": row[1].text or "" for row in rows}


class Tags(HTMLParser):
    def __init__(self, markup: str) -> None:
        super().__init__()
        self.names: set[str] = set()
        self.attributes: set[str] = set()
        self.feed(markup)

    def handle_starttag(self, tag, attrs) -> None:
        self.names.add(tag)
        self.attributes |= {name for name, _ in attrs}


def check_harmless(markup: str) -> None:
    tags = Tags(markup)
    assert tags.names <= {"div", "strong", "table", "tr", "th", "td", "svg", "path", "circle"}
    assert tags.attributes <= {
        *("style", "xmlns", "shape-rendering", "width", "height", "viewbox", "fill", "d", "cx", "cy", "r")
    }
    assert markup.isprintable()
    assert len(markup) < 20_000


def test_names_and_values_are_escaped_cut_and_printable() -> None:
    markup = facts_html(HOSTILE, [(HOSTILE, HOSTILE), ("nothing", None), ("empty", ""), ("zero", 0)])
    check_harmless(markup)
    (name, value), zero = list(cells_of(markup).items())
    assert name == value == HOSTILE.replace("\x1b", "?")[:196] + " ..."
    assert zero == ("zero", "0")


@pytest.mark.parametrize("name", robosim.arena_names())
def test_the_picture_of_an_arena_has_the_colour_of_the_zone_in_every_cell(name) -> None:
    arena = robosim.load_arena(name)
    painted = np.full(arena.zones.shape, -1)
    zone_of = {css(colour): zone for zone, colour in ZONE_COLOURS.items()}
    for path in ET.fromstring(arena_svg(arena)):
        for run in path.get("d").removeprefix("M").split("M"):
            corner, length, _ = run.split("h")
            x, y = map(int, corner.split(" "))
            cells = painted[y, x : x + int(length.removesuffix("v1"))]
            assert (cells == -1).all()
            cells[:] = zone_of[path.get("fill")]
    np.testing.assert_array_equal(painted[::-1], arena.zones)


def test_an_arena_from_a_stranger() -> None:
    text = robosim.load_arena("paper").text.replace('name = "paper"', 'name = "p"', 1)
    hostile = text.split("description =")[0] + 'description = "<img src=x onerror=alert(1)>"\n'
    rest = text.split("description =")[1].split("\n", 1)[1]
    markup = parse_arena(hostile + rest, "<b>.toml")._repr_html_()
    check_harmless(markup)
    cells = cells_of(markup)
    assert cells["description"] == "<img src=x onerror=alert(1)>"
    assert cells["size"] == "3.90 x 1.20 m, 26 x 8 cells of 0.15 m"


def test_a_map_too_ragged_is_not_drawn() -> None:
    ragged = np.resize(np.array([Zone.FLOOR, Zone.HOME], np.uint8), (30, 200))
    arena = dataclasses.replace(robosim.load_arena("paper"), zones=ragged)
    assert arena_svg(arena) == ""
    check_harmless(arena._repr_html_())


def test_an_environment_shows_where_its_robots_are() -> None:
    env = robosim.vector_env("paper", robots=3, num_envs=2)
    assert cells_of(env._repr_html_())["now"] == "before the first reset"
    env.reset()
    for _ in range(5):
        env.step(np.zeros((2, 3), np.int64))
    markup = env._repr_html_()
    check_harmless(markup)
    circles = [one for one in ET.fromstring(markup).iter() if one.tag.endswith("circle")]
    drawn = np.array([[float(one.get("cx")), float(one.get("cy"))] for one in circles])
    places = env.frame(0).pose[:, :2] / env.arena.cell_size
    np.testing.assert_allclose(drawn, [[x, env.arena.rows - y] for x, y in places], atol=0.006)
    cells = cells_of(markup)
    assert cells["observation"] == f"float32 [2, 3, {env.layout.size}]"
    assert cells["now"] == "decision 5 of episode 0, 0 pellets home in the first environment"


def test_other_faces_show_the_same() -> None:
    parallel = robosim.parallel_env("paper", robots=2)
    check_harmless(parallel._repr_html_())
    parallel.reset(seed=0)
    assert "decision 0 of episode 0" in cells_of(parallel._repr_html_())["now"]


def test_a_policy_shows_what_its_card_says() -> None:
    policy = robosim.load_policy("paper-8")
    cells = cells_of(policy._repr_html_())
    assert cells["team"] == "8 robots in arena paper, world physics"
    assert cells["pellets"].startswith(f"{policy.card.evaluation.mean:.1f} ± ")
    assert cells["of the reference"] == f"{100 * policy.card.share:.0f} %"
    hostile = policy.card.changed(notes=HOSTILE[:1000].replace("\x1b", "\x07"))
    check_harmless(Policy(policy.weights(), hostile)._repr_html_())


def test_an_evaluation_shows_its_episodes() -> None:
    evaluation = Evaluation(
        controller=HOSTILE[:100], arena="<i>paper", robots=2, episode_steps=100, seed=3,
        delivered=[[1, 2]] * 30, collisions=[4] * 30, closest=[0.25, *[0.5] * 29],
        longest_lapse=[50, 100, *[40] * 28],
    )  # fmt: skip
    markup = evaluation._repr_html_()
    check_harmless(markup)
    cells = cells_of(markup)
    assert cells["team"] == "2 robots in arena <i>paper, world physics"
    assert cells["in each episode"] == "3 " * 20 + "..."
    assert cells["by robot"] == "1.0 2.0"
    assert cells["longest lapse"] == "100 decisions without a delivery"
    assert cells["collisions"] == "4.0 per episode"
    assert cells["least distance of two robots"] == "0.250 m"
