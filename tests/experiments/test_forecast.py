import pytest

from robosim.experiments.forecast import Forecast, Running
from robosim.experiments.results import Result


def config(technique="iql", robots=2, steps=1000, episodes=5, world="grid"):
    learned = {} if technique == "lanes" else {"schedule": {"steps": steps}}
    env = {"world": world, "robots": robots}
    return {"env": env, "run": {"technique": technique}, "evaluation": {"episodes": episodes}, **learned}


def done(learning, measuring, **options):
    return Result("", config(**options), {}, learning, {}, {}, measuring)


def test_nothing_is_expected_before_there_is_anything_to_go_by():
    assert Forecast().seconds(config()) is None
    assert Forecast().left([config()], [], 2) is None
    assert Forecast().left([], [], 2) == 0.0
    # What only measures says nothing of how long learning takes.
    assert Forecast([done(0.0, 10.0, technique="lanes")]).seconds(config()) is None


def test_a_job_takes_what_those_most_like_it_took():
    forecast = Forecast([done(10.0, 5.0), done(30.0, 15.0), done(100.0, 50.0, robots=4)])
    assert forecast.seconds(config()) == pytest.approx(20.0 + 10.0)
    assert forecast.seconds(config(steps=3000, episodes=1)) == pytest.approx(60.0 + 2.0)
    assert forecast.seconds(config(robots=4)) == pytest.approx(150.0)
    # No team of eight: all of the technique. Another technique: all of the world.
    assert forecast.seconds(config(robots=8)) == pytest.approx(140 / 3 + 70 / 3)
    assert forecast.seconds(config("smadrl", world="physics")) == pytest.approx(140 / 3 + 70 / 3)
    assert forecast.seconds(config("lanes")) == pytest.approx(70 / 3)


def test_what_is_left_is_shared_out_and_lasts_as_long_as_the_longest_job():
    forecast = Forecast([done(10.0, 5.0)])
    assert forecast.left([config()] * 4, [], 2) == pytest.approx(30.0)
    assert forecast.left([config()], [Running(config(), 5.0, 0.0, 0.0)], 1) == pytest.approx(30.0)
    # 100 s for a tenth: the job's own speed counts once it shows, from where it was first heard of.
    slow = Running(config(), 100.0, 0.4, 0.5)
    assert forecast.left([config()], [slow], 2) == pytest.approx(500.0)
    assert Forecast().left([config()], [slow], 2) == pytest.approx(500.0)
