"""What each noise alone costs a team: the shares are those of evaluations under it."""

import json
from pathlib import Path

import pytest

from robosim.analysis import robustness
from robosim.analysis.figures.robustness import draw_robustness
from robosim.analysis.robustness import NOISES, Noise, Robustness, measure_robustness, noises_for, table_of
from robosim.cli.main import main
from robosim.control.controller import make_controller
from robosim.control.environment import environment_for
from robosim.control.evaluate import evaluate
from robosim.envs.profile import ProfileConfig
from robosim.envs.vector import VectorEnv
from robosim.errors import IncompleteError

LANES = make_controller("lanes")
FEW = (
    Noise("lost fixes", "probability", (0.1, 0.5), lambda size: {"sensing_dropout": size}),
    Noise("late commands", "s", (0.75, 30.0), lambda size: {"motion_latency": (min(size, 5.0),) * 2}),
)


def grid(**options: object) -> VectorEnv:
    return environment_for(LANES, "paper", 4, "grid", num_envs=2, episode_steps=150, **options)  # type: ignore[arg-type]


def test_shares_are_those_of_evaluations_under_each_noise_alone() -> None:
    env = grid()
    reference = evaluate(LANES, env, 2, 7)
    told = []
    found = measure_robustness(LANES, env, reference, FEW, lambda name, level: told.append((name, level)))
    assert found.delivered == reference.totals
    for noise, curve in zip(FEW, found.curves, strict=True):
        for size, level in zip(noise.sizes, curve.levels, strict=True):
            profile = ProfileConfig().with_options(**noise.options(size))
            alone = evaluate(LANES, grid(profile=profile), 2, 7)
            assert level.delivered == alone.totals
            assert level.share == pytest.approx(alone.mean / reference.mean)
            assert level.error == pytest.approx(alone.std / 2**0.5 / reference.mean)
    assert [(name, level.size) for name, level in told] == [
        (noise.name, size) for noise in FEW for size in noise.sizes
    ]
    late = found.curves[1]
    jammed = [level.size for level in late.levels if level.share <= 0.1]
    assert late.jams_at == (jammed[0] if jammed else None)


def test_a_profile_that_is_there_stays_beneath_each_noise() -> None:
    env = grid(profile={"sensing": {"delay": 1}, "name": "late"})
    found = measure_robustness(LANES, env, evaluate(LANES, env, 2, 7), FEW[:1])
    assert found.profile == env.config.profile
    below = ProfileConfig(name="late").with_options(sensing_delay=1, sensing_dropout=0.5)
    assert found.curves[0].levels[1].delivered == evaluate(LANES, grid(profile=below), 2, 7).totals


def test_every_noise_is_a_profile_of_its_own_that_says_what_it_is() -> None:
    for noise in NOISES:
        assert list(noise.sizes) == sorted(noise.sizes)
        made = {ProfileConfig().with_options(**noise.options(size)) for size in noise.sizes}
        assert len(made) == len(noise.sizes)
        assert ProfileConfig() not in made
    env = VectorEnv("paper", stigmergy=False)
    assert {noise.name for noise in NOISES} - {noise.name for noise in noises_for(env)} == {
        "pheromone noise", "lost pheromones", "late pheromones",
    }  # fmt: skip
    on_grid = VectorEnv("paper", world="grid")
    assert {noise.name for noise in NOISES} - {noise.name for noise in noises_for(on_grid)} == {
        "motor lag", "wheel mismatch", "lost traction",
    }  # fmt: skip
    late = next(noise for noise in noises_for(on_grid) if noise.name == "late commands")
    assert late.sizes == (0.75, 1.5, 2.25)
    for noise in noises_for(on_grid):
        VectorEnv(on_grid.config, profile=ProfileConfig().with_options(**noise.options(noise.sizes[0])))


def test_a_team_that_delivers_nothing_has_no_share_to_keep() -> None:
    env = environment_for(LANES, "paper", 2, num_envs=1, episode_steps=2)
    with pytest.raises(IncompleteError, match="^lanes delivers nothing even without noise, so there is no"):
        measure_robustness(LANES, env, evaluate(LANES, env, 1, 0), FEW)


def test_the_command_leaves_figure_table_and_json(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(robustness, "NOISES", FEW)
    command = ["evaluate", "lanes", "--world", "grid", "--episodes", "2", "--steps", "150", "--seed", "7"]
    out = tmp_path / "out"
    assert main([*command, "--robustness", str(out)]) == 0
    assert sorted(path.name for path in out.iterdir()) == [
        "robustness.json", "robustness.md", "robustness.png", "robustness.svg",
    ]  # fmt: skip
    found = Robustness.from_table(json.loads((out / "robustness.json").read_text()), "robustness.json")
    table = (out / "robustness.md").read_text()
    assert table == table_of(found)
    assert table.count("\n| l") == 2
    assert f"| {found.curves[0].levels[0].size:g}: {found.curves[0].levels[0].share:.2f} +- " in table
    assert len(draw_robustness([found]).axes) == 2
    assert "lost fixes" in capsys.readouterr().out
    assert main([*command, "--robustness", str(out)]) == 2
    assert "this folder is not empty" in capsys.readouterr().err


def test_several_teams_are_drawn_side_by_side(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(robustness, "NOISES", FEW[:1])
    command = ["evaluate", "lanes", "active", "--robots", "4", "--world", "grid", "--episodes", "2"]
    out = tmp_path / "out"
    assert main([*command, "--steps", "150", "--seed", "7", "--robustness", str(out)]) == 0
    both = json.loads((out / "robustness.json").read_text())
    found = [Robustness.from_table(one, "robustness.json") for one in both]
    assert [one.controller for one in found] == ["lanes", "active"]
    env = grid()
    assert found[0] == measure_robustness(LANES, env, evaluate(LANES, env, 2, 7), FEW[:1])
    assert (out / "robustness.md").read_text() == "\n".join(map(table_of, found))
    figure = draw_robustness(found)
    (axes,) = figure.axes
    for one, container in zip(found, axes.containers, strict=True):
        (curve,) = one.curves
        assert list(container.lines[0].get_ydata()) == [1.0, *(level.share for level in curve.levels)]
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    mean = sum(found[0].delivered) / 2
    assert labels[0] == f"lanes ({mean:.1f} pellets)"
    assert "active:" in capsys.readouterr().out


def test_a_team_that_delivers_nothing_is_told_before_the_others_are_studied(tmp_path: Path, capsys) -> None:
    out = tmp_path / "out"
    command = ["evaluate", "lanes", "random", "--world", "grid", "--episodes", "1", "--steps", "150"]
    assert main([*command, "--robustness", str(out)]) != 0
    told = capsys.readouterr()
    assert "random delivers nothing even without noise" in told.err
    assert "lost fixes" not in told.out
    assert not out.exists()
