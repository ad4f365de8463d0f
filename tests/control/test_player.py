import numpy as np

from robosim.control.network import Networks, NetworkSpec
from robosim.control.player import Player
from robosim.discretise.observation import Columns, MoveGains

COLUMNS = Columns(MoveGains(0, 4, 4), 8, 9)
SPEC = NetworkSpec(inputs=10, hidden=[8], of_robot=[0, 0, 0], temperature=0.5, retreat_in_place=6)


def networks(spec):
    rng = np.random.default_rng(0)
    weights = {name: rng.normal(size=shape).astype(np.float32) for name, shape in spec.shapes.items()}
    return Networks(spec, weights, COLUMNS)


def standing(count, envs=40, robots=3):
    rng = np.random.default_rng(1)
    seen = rng.uniform(-0.9, 0.9, (count, envs, robots, 10)).astype(np.float32)
    seen[..., 8] = 0.5
    return seen


def test_who_retreats_is_remembered_from_one_decision_to_the_next():
    team, left = networks(SPEC), np.zeros((40, 3), np.int64)
    player = Player(team.act, SPEC)
    begun = 0
    for decision, seen in enumerate(standing(30)):
        before = left.copy()
        expected = team.act(seen, decision, left)
        assert (player.act(seen, decision) == expected).all()
        assert (left[before > 0] == before[before > 0] - 1).all()
        begun += ((before == 0) & (left > 0)).sum()
    assert begun > 100


def test_an_episode_begins_with_nobody_in_retreat():
    player = Player(networks(SPEC).act, SPEC)
    runs = [[player.act(seen, decision).tolist() for decision, seen in enumerate(standing(20))] for _ in "12"]
    assert runs[0] == runs[1]


def test_another_number_of_robots_begins_anew():
    team, player = networks(SPEC), Player(networks(SPEC).act, SPEC)
    for decision, seen in enumerate(standing(10)):
        player.act(seen, decision)
    seen = standing(1, envs=2, robots=5)[0]
    assert (player.act(seen, 10) == team.act(seen, 10, np.zeros((2, 5), np.int64))).all()


def test_others_remember_nothing():
    plain = SPEC.changed(retreat_in_place=None)
    team, player = networks(plain), Player(networks(plain).act, plain)
    for decision, seen in enumerate(standing(10)):
        assert (player.act(seen, decision) == team.act(seen, decision)).all()
