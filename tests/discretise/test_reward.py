from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.control.controller import make_controller
from robosim.discretise import reward as registry
from robosim.discretise.reward import Outcome, RewardConfig, register_reward, rewards
from robosim.envs.vector import VectorEnv
from robosim.errors import InputError
from tests.discretise.plain import reward_of
from tests.discretise.recorded import RUNS, recorded

YES, NO = np.array([[True]]), np.array([[False]])
FULL, LITTLE, BACK, STILL = (np.array([[gained]]) for gained in (1.0, 0.11, -1.0, 0.1))
NONE, ONE = np.array([[0]]), np.array([[1]])


@pytest.mark.parametrize(
    ("signal", "value"),
    [
        ({}, 0.0),
        ({"gained": FULL}, 0.2 * 2.5),
        ({"gained": LITTLE}, 0.2 * 2.5),
        ({"gained": BACK}, 0.0),
        ({"collided": YES}, 0.2 * -2.0),
        ({"collided": YES, "laden": YES}, 0.0),
        ({"gained": FULL, "laden": YES}, 0.2 * 2.5),
        ({"pickups": ONE}, 0.2 * 50.0),
        ({"deliveries": ONE}, 0.4 * 50.0),
        ({"gained": FULL, "collided": YES, "pickups": ONE, "deliveries": ONE}, 0.5 - 0.4 + 10.0 + 20.0),
    ],
)
def test_the_four_signals_have_the_papers_values_and_weights(
    signal: dict[str, np.ndarray], value: float
) -> None:
    nothing = {
        "gained": STILL,
        "collided": NO,
        "laden": NO,
        "pickups": NONE,
        "deliveries": NONE,
        "idle": YES,
        "touching": YES,
        "nearest": None,
    }
    assert rewards(RewardConfig(), **(nothing | signal)).tolist() == [[pytest.approx(value)]]


def test_signed_distance_pays_by_length_and_to_and_fro_earns_nothing() -> None:
    gains = np.array([[1.0, -1.0, 0.5, -0.25, 0.0, 7.0, -7.0]])
    none, no = np.zeros(gains.shape, dtype=np.int64), np.zeros(gains.shape, dtype=np.bool_)
    config = RewardConfig(signed_distance=True)
    paid = rewards(config, gains, no, no, none, none, no, no, None)
    assert paid[0].tolist() == pytest.approx([0.5, -0.5, 0.25, -0.125, 0.0, 0.5, -0.5])


def test_idle_cost_charges_a_decision_without_way_what_top_speed_pays() -> None:
    none, no = np.zeros((1, 2), dtype=np.int64), np.zeros((1, 2), dtype=np.bool_)
    still, idle = np.zeros((1, 2)), np.array([[True, False]])
    for config, paid in ((RewardConfig(idle_cost=True), [-0.5, 0.0]), (RewardConfig(), [0.0, 0.0])):
        assert rewards(config, still, no, no, none, none, idle, no, None)[0].tolist() == pytest.approx(paid)


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from(["local", "global"]),
    st.sampled_from(["copied", "split"]),
    st.booleans(),
    st.booleans(),
    st.sampled_from([None, 0.0, 0.75]),
    st.sampled_from([None, 0.3, 2.0]),
)
def test_a_batch_is_what_loops_say(
    seed: int,
    kind: Literal["local", "global"],
    sharing: Literal["copied", "split"],
    signed: bool,
    idle_cost: bool,
    touch_cost: float | None,
    spacing: float | None,
) -> None:
    rng = np.random.default_rng(seed)
    envs, robots = 3, int(rng.integers(1, 9))
    gained = rng.normal(0.0, 0.5, (envs, robots))
    collided, laden, idle, touching = rng.random((4, envs, robots)) < 0.5
    nearest = rng.uniform(0.0, 1.0, (envs, robots)) if robots > 1 else np.full((envs, robots), np.inf)
    pickups = rng.integers(0, 2, (envs, robots))
    deliveries = rng.integers(0, 4, (envs, robots))
    config = RewardConfig(
        kind=kind,
        sharing=sharing,
        signed_distance=signed,
        idle_cost=idle_cost,
        touch_cost=touch_cost,
        spacing=spacing,
        spacing_cost=None if spacing is None else 1.5,
    )
    got = rewards(config, gained, collided, laden, pickups, deliveries, idle, touching, nearest)
    for env in range(envs):
        for robot in range(robots):
            if kind == "local":
                picked, dumped = pickups[env, robot], deliveries[env, robot]
            else:
                divisor = robots if sharing == "split" else 1
                picked = sum(pickups[env].tolist()) / divisor
                dumped = sum(deliveries[env].tolist()) / divisor
            alone = gained[env, robot], collided[env, robot], laden[env, robot]
            expected = reward_of(*alone, picked, dumped, idle[env, robot], signed=signed, idle_cost=idle_cost)
            if touch_cost and touching[env, robot]:
                expected -= touch_cost
            if spacing and nearest[env, robot] < spacing:
                expected -= 1.5 * (spacing - nearest[env, robot]) / spacing
            assert got[env, robot] == pytest.approx(expected, abs=1e-12)


def test_a_shared_reward_stays_within_its_environment() -> None:
    pickups = np.array([[1, 0, 0], [0, 0, 0]])
    no = np.zeros((2, 3), dtype=np.bool_)
    none = np.zeros((2, 3), dtype=np.int64)
    still = np.zeros((2, 3))
    copied = rewards(
        RewardConfig(kind="global", sharing="copied"), still, no, no, pickups, none, no, no, None
    )
    assert copied.tolist() == [[10.0, 10.0, 10.0], [0.0, 0.0, 0.0]]
    split = rewards(RewardConfig(kind="global", sharing="split"), still, no, no, pickups, none, no, no, None)
    assert split.tolist() == [[10.0 / 3] * 3, [0.0] * 3]
    local = rewards(RewardConfig(kind="local"), still, no, no, pickups, none, no, no, None)
    assert local.tolist() == [[10.0, 0.0, 0.0], [0.0] * 3]


def test_along_a_run_a_pellet_pays_once_until_it_is_delivered() -> None:
    """Robots that keep losing their pellets earn nothing by taking them again; fresh ones pay again."""
    run = recorded("tiny")
    assert run.reward == "global"
    taken = paid = delivered = 0
    for env in range(run.num_envs):
        trips = set()
        generation = [0] * run.arena.pellets.count
        held = run.start.held[env]
        for moment in run.moments:
            # First, since a pellet can be taken in the decision in which it appears.
            for pellet in np.flatnonzero(moment.fresh[env]).tolist():
                generation[pellet] += 1
            for robot, pellet in enumerate(moment.held[env].tolist()):
                if pellet >= 0 and held[robot] < 0:
                    taken += 1
                    trips.add((pellet, generation[pellet]))
            held = moment.held[env]
            delivered += int(moment.deliveries[env].sum())
        paid += len(trips)
        shaping = sum(
            0.5 * _closer(run, env, index) - 0.4 * _penalised(run, env, index)
            for index in range(len(run.moments))
        )
        total = sum(float(moment.reward[env].sum(dtype=np.float64)) for moment in run.moments)
        pays = 10.0 * len(trips) + 20.0 * sum(int(m.deliveries[env].sum()) for m in run.moments)
        assert total == pytest.approx(run.robots * pays + shaping, abs=1e-3)
        assert max(generation) > 0
    assert taken > 2 * paid > 0
    assert delivered > 0


def _before(run, index):
    return run.moments[index - 1] if index else run.start


def _closer(run, env: int, index: int) -> int:
    before, after = _before(run, index), run.moments[index]
    goal = np.where(before.held[env] >= 0, 0, 1)
    sample = run.arena.distances.sample
    gain = sample(before.pose[env, :, :2]) - sample(after.pose[env, :, :2])
    least = 0.1 * run.arena.robot.top_speed * run.arena.timing.decision_period
    return sum(bool(gain[robot, goal[robot]] > least) for robot in range(run.robots))


def _penalised(run, env: int, index: int) -> int:
    return int((run.moments[index].collided[env] & (_before(run, index).held[env] < 0)).sum())


@pytest.mark.parametrize("name", sorted(RUNS.keys() - {"signed"}))
def test_nobody_is_fined_for_standing_or_while_laden(name: str) -> None:
    """The least reward is the fine, and it falls on nobody who stood still or carried a pellet."""
    run = recorded(name)
    held = run.start.held
    for moment in run.moments:
        fined = moment.reward < 0.0
        assert not (fined & (held >= 0)).any()
        assert not (fined & (moment.actions == 4)).any()
        assert moment.reward.min() >= np.float32(-0.4)
        held = moment.held


def test_an_idle_weight_of_its_own_leaves_the_pay_for_distance_alone() -> None:
    gained = np.array([[1.0, -0.5, 0.0]])
    idle = np.array([[False, False, True]])
    no, none = np.zeros((1, 3), dtype=np.bool_), np.zeros((1, 3), dtype=np.int64)
    for weight, charge in ((None, 0.125), (0.3, 0.75), (0.0, 0.0)):
        config = RewardConfig(
            signed_distance=True, distance_weight=0.05, idle_cost=True, idle_weight=weight, kind="local"
        )
        got = rewards(config, gained, no, no, none, none, idle, no, None)
        assert got.tolist() == [pytest.approx([0.125, -0.0625, -charge])]


@pytest.mark.parametrize(
    ("given", "missing"),
    [
        ({"spacing": 0.2}, "spacing_cost"),
        ({"spacing_cost": 1.0}, "spacing"),
        ({"idle_weight": 0.2}, "idle_cost"),
    ],
)
def test_what_needs_another_says_so(given: dict[str, float], missing: str) -> None:
    with pytest.raises(InputError, match=f"reward: .*{next(iter(given))} needs {missing}, too"):
        RewardConfig.from_table(given, "reward")


def test_touching_and_nearness_cost_in_the_world_whoever_is_under_way_and_laden_or_not() -> None:
    """The same actions with and without the costs: rewards differ by what positions and touches say."""
    costs = {"touch_cost": 0.75, "spacing": 0.3, "spacing_cost": 1.5}
    plain, gentle = (VectorEnv("paper", robots=6, num_envs=2, seed=[1, 2], **more) for more in ({}, costs))
    keeper = make_controller("lanes")
    observation, _ = plain.reset(), gentle.reset()
    keeper.reset(plain)
    charged = touches = 0.0
    for _ in range(250):
        actions = keeper.act(plain, observation)
        free, paid = plain.step(actions), gentle.step(actions)
        observation = free.observation
        pose, touched = plain.world.state.pose, plain.world.state.touched[0]
        for env, robot in np.ndindex(2, 6):
            others = [
                np.hypot(*(pose[env, robot, :2] - pose[env, other, :2]))
                for other in range(6)
                if other != robot
            ]
            cost = 0.75 * touched[env, robot] + 1.5 * max(0.0, 1.0 - min(others) / 0.3)
            assert free.reward[env, robot] - paid.reward[env, robot] == pytest.approx(cost, abs=1e-4)
            charged += cost
            touches += touched[env, robot]
    assert touches > 0
    assert charged > 0.75 * touches


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forget after the test what it registers."""
    monkeypatch.setattr(registry, "_REGISTERED", {})


@pytest.mark.usefixtures("registered")
@pytest.mark.parametrize("world", ["physics", "grid"])
def test_an_extra_reward_is_told_what_happened_and_added_to_the_rest(
    world: Literal["physics", "grid"],
) -> None:
    told: list[Outcome] = []

    def mine(outcome: Outcome) -> np.ndarray:
        told.append(outcome._replace(laden=outcome.laden.copy()))
        return 0.5 * outcome.laden - 0.25 * (outcome.actions == 4)

    register_reward("mine", mine)
    plain = VectorEnv("paper", world=world, robots=4, num_envs=2, seed=3, reward="local")
    extra = VectorEnv("paper", world=world, robots=4, num_envs=2, seed=3, reward="local", extra_reward="mine")
    keeper = make_controller("lanes")
    observation, _ = plain.reset(), extra.reset()
    keeper.reset(plain)
    pickups, delivered = np.zeros((2, 4)), np.zeros((2, 4))
    laden = plain.world.state.held >= 0
    for step in range(200):
        actions = keeper.act(plain, observation)
        actions[step % 2, step % 4] = 4
        usual, paid = plain.step(actions), extra.step(actions)
        outcome = told[-1]
        assert np.array_equal(outcome.reward.astype(np.float32), usual.reward)
        assert np.array_equal(outcome.laden, laden)
        expected = outcome.reward + 0.5 * laden - 0.25 * (actions == 4)
        assert np.array_equal(paid.reward, expected.astype(np.float32))
        assert np.array_equal(outcome.collided, usual.collided)
        assert np.array_equal(outcome.blocked, usual.blocked)
        assert outcome.state is extra.world.state
        assert outcome.setting.arena.name == "paper"
        laden = plain.world.state.held >= 0
        pickups += outcome.pickups
        delivered += outcome.deliveries
        observation = usual.observation
    assert len(told) == 200
    assert np.array_equal(delivered, plain.delivered)
    assert np.array_equal(pickups - delivered, laden)
    assert delivered.sum() > 0


@pytest.mark.usefixtures("registered")
def test_an_extra_reward_that_nobody_knows_is_refused() -> None:
    unknown = 'unknown extra reward "mine": '
    with pytest.raises(InputError) as caught:
        VectorEnv(extra_reward="mine")
    assert str(caught.value) == f"{unknown}none is registered (register_reward)."
    register_reward("mind", lambda outcome: outcome.reward)
    with pytest.raises(InputError) as caught:
        VectorEnv(extra_reward="mine")
    assert str(caught.value) == f"{unknown}did you mean mind?"


@pytest.mark.usefixtures("registered")
@pytest.mark.parametrize(
    ("returned", "what"),
    [
        (np.zeros(3), "an array of type float64 and shape [3]"),
        (np.zeros((1, 3, 1)), "an array of type float64 and shape [1, 3, 1]"),
        (np.zeros((1, 3), dtype=complex), "an array of type complex128 and shape [1, 3]"),
        (None, "an array of type object and shape []"),
        (np.array([[0.0, np.nan, 1.0]]), "nan"),
        (np.array([[-np.inf, 0.0, 1.0]]), "-inf"),
    ],
)
def test_what_an_extra_reward_may_not_return_is_a_sentence(returned: object, what: str) -> None:
    register_reward("mine", lambda outcome: returned)  # type: ignore[arg-type, return-value]
    env = VectorEnv(robots=3, extra_reward="mine")
    env.reset()
    with pytest.raises(InputError) as caught:
        env.step([[4, 4, 4]])
    allowed = "finite numbers, [envs, robots] = [1, 3]"
    assert str(caught.value) == f'extra reward "mine" returned {what}, but must return {allowed}.'
