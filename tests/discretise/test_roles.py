"""Roles: who digs, who hands over, who brings home, and what each is paid for it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.arena import load_arena
from robosim.arena.model import Zone
from robosim.control.lanes import LanesController
from robosim.discretise.goals import Goals
from robosim.discretise.modes import Mode, gripper_commands, modes
from robosim.envs.vector import VectorEnv
from robosim.robot.team import Role
from robosim.world.state import Gripper, PelletStatus

GRID = """
name = "yard"
cell_size = 0.2
map = '''
################
#HH.TTT.XX.SSS.#
#HH.TTT.XX.SSS.#
#HH.TTT.XX.SSS.#
################
'''
[pellets]
count = 12
[[groups]]
name = "diggers"
role = "excavator"
[[groups]]
name = "carriers"
role = "transporter"
"""


def plain_mode(role: Role, zone: Zone, laden: bool, touching: bool) -> Mode:
    brings = Zone.HANDOVER if role == Role.EXCAVATOR else Zone.HOME
    takes = Zone.HANDOVER if role == Role.TRANSPORTER else Zone.SOURCE
    if laden:
        return {brings: Mode.DUMPING, takes: Mode.EXIT_DIGGING}.get(zone, Mode.GOING_HOME)
    if zone == takes:
        return Mode.DIGGING
    if zone == brings:
        return Mode.EXIT_HOME
    own = {Zone.FLOOR, Zone.TUNNEL} | ({Zone.HANDOVER} if role == Role.ALL_ROUND else set())
    return Mode.DIGGING if touching and zone in own else Mode.GOING_TO_DIG


@given(st.sampled_from(Role), st.sampled_from(Zone), st.booleans(), st.booleans())
def test_a_robot_s_mode_follows_from_its_role(role: Role, zone: Zone, laden: bool, touching: bool) -> None:
    given_ = np.array([zone], np.uint8), np.array([laden]), np.array([touching])
    mode = modes(*given_, np.array([role]))
    assert mode[0] == plain_mode(role, zone, laden, touching)
    if role == Role.ALL_ROUND:
        assert modes(*given_)[0] == mode[0]
    gripper = gripper_commands(mode)[0]
    # Nobody takes or drops where that is the work of others.
    if role == Role.EXCAVATOR:
        assert not (gripper == Gripper.OPEN and zone == Zone.HOME)
        assert not (gripper == Gripper.TAKE and zone in {Zone.HANDOVER, Zone.HOME})
    if role == Role.TRANSPORTER:
        assert not (gripper == Gripper.OPEN and zone != Zone.HOME)
        assert not (gripper == Gripper.TAKE and zone == Zone.SOURCE)


def test_distances_are_those_to_a_robot_s_own_goals() -> None:
    arena = load_arena("relay")
    goals = Goals(arena, arena.team(2))
    places = (np.array([[[25, 2], [5, 3]]]) + 0.5) * arena.cell_size
    own = goals.sample(places)[0]
    handover = arena.handover
    assert handover is not None
    to_home, to_source = arena.distances.sample(places)[0].T
    to_handover = handover.sample(places)[0, :, 0]
    assert own[0].tolist() == [to_handover[0], to_source[0]]
    assert own[1].tolist() == [to_home[1], to_handover[1]]
    # From the nearest edge of the hand-over, straight.
    x = places[0, 0, 0]
    assert to_handover[0] == pytest.approx(x - 24 * arena.cell_size)
    around = np.repeat(places[:, :, None], 3, axis=2)
    assert np.array_equal(goals.sample(around), np.repeat(own[None, :, None], 3, axis=2))


class PlainBooks:
    """What is paid to whom, and where pellets are, from the states alone, robot by robot."""

    def __init__(self, env: VectorEnv) -> None:
        self.env = env
        self.dug: set[int] = set()
        self.taken: set[int] = set()
        self.handed: set[int] = set()
        self.held = env.world.state.held[0].copy()

    def step(self) -> tuple[list[int], list[int]]:
        """Return first pickups and deliveries or first hand-overs of each robot in the last decision."""
        state, arena, team = self.env.world.state, self.env.arena, self.env.world.team
        for pellet in np.flatnonzero(state.fresh[0]).tolist():
            for book in (self.dug, self.taken, self.handed):
                book.discard(pellet)
        pickups, brought = [], []
        for robot in range(self.env.robots):
            role = Role(team.role[robot])
            book = self.taken if role == Role.TRANSPORTER else self.dug
            pellet = int(state.picked[0, robot])
            pickups.append(int(pellet >= 0 and pellet not in book))
            book |= {pellet} - {-1}
            before = int(self.held[robot])
            count = int(state.deliveries[0, robot])
            if role == Role.EXCAVATOR:
                count = 0
                if before >= 0 and state.held[0, robot] != before and before not in self.handed:
                    x, y = state.pellets[0, before]
                    zone = arena.zones[int(y / arena.cell_size), int(x / arena.cell_size)]
                    count = int(zone == Zone.HANDOVER and state.pellet_status[0, before] != 2)
                    self.handed |= {before} if count else set()
            brought.append(count)
        self.held = state.held[0].copy()
        return pickups, brought


@pytest.mark.parametrize(
    ("world", "text", "decisions"), [("physics", "relay", 250), ("grid", GRID, 250)], ids=["physics", "grid"]
)
def test_pellets_are_handed_over_and_none_is_made_or_lost(world: str, text: str, decisions: int) -> None:
    pays = {"reward": "local", "reward_distance": 0.0, "reward_collision": 0.0}
    env = VectorEnv(text, world=world, robots=4, seed=5, **pays)
    lanes, observation = LanesController(), env.reset()
    lanes.reset(env)
    books, role = PlainBooks(env), env.world.team.role
    state, pellets = env.world.state, env.arena.pellets.count
    rng = np.random.default_rng(0)
    for _ in range(decisions):
        action = lanes.act(env, observation)
        # Some of it at random, so that robots also meet where they should not.
        action = np.where(rng.random(action.shape) < 0.05, rng.integers(0, 5, action.shape), action)
        zones = env.dec_pomdp.grid.zones.take(env.dec_pomdp._true.cell)[0]
        step = env.step(action)
        observation = step.observation
        loose, held, absent = ((state.pellet_status[0] == status).sum() for status in PelletStatus)
        assert loose + held + absent == pellets
        assert absent == state.delivered[0] - state.refilled[0]
        assert sorted(state.held[0][state.held[0] >= 0]) == list(np.flatnonzero(state.pellet_status[0] == 1))
        # The gripper does what the mode at the end of the decision before has commanded.
        took = state.picked[0] >= 0
        assert not (took & (role == Role.EXCAVATOR) & np.isin(zones, [Zone.HANDOVER, Zone.HOME])).any()
        assert not (took & (role == Role.TRANSPORTER) & (zones == Zone.SOURCE)).any()
        let_go = (books.held >= 0) & (state.held[0] < 0) & ~state.lost[0]
        assert not (let_go & (role == Role.EXCAVATOR) & (zones != Zone.HANDOVER)).any()
        assert not (let_go & (role == Role.TRANSPORTER) & (zones != Zone.HOME)).any()
        pickups, brought = books.step()
        expected = 10.0 * np.array(pickups) + 20.0 * np.array(brought)
        np.testing.assert_allclose(step.reward[0], expected.astype(np.float32))
    assert (env.handed_over[0][role == Role.EXCAVATOR] > 0).all()
    assert (env.handed_over[0][role == Role.TRANSPORTER] == 0).all()
    assert (env.delivered[0][role == Role.TRANSPORTER] > 0).all()


def test_a_pellet_handed_over_again_is_paid_once() -> None:
    """Excavators that hand over, push out and dig up the same pellets are paid for each one once."""
    env = VectorEnv(GRID, world="grid", robots=1, seed=0, reward="local", reward_distance=0.0)
    env.reset()
    state, truth = env.world.state, env.dec_pomdp.truth
    robot = np.zeros((1, 1), dtype=np.int64)
    paid = []
    for _ in range(2):
        for held, place in ((3, (1.9, 0.5)), (-1, (1.7, 0.5))):
            state.held[0, 0] = held
            state.picked[0, 0] = held
            state.pellets[0, 3] = place
            state.pellet_status[0, 3] = PelletStatus.HELD if held >= 0 else PelletStatus.LOOSE
            env.dec_pomdp.update(robot, state)
            paid.append(int(truth.handed_over[0, 0]))
    assert paid == [0, 1, 0, 0]


@pytest.mark.parametrize("actions", ["cardinal", "wheels"])
def test_progress_is_paid_toward_a_robot_s_own_goal_at_its_own_pace(actions: str) -> None:
    pays = {"signed_distance": True, "reward_pickup": 0.0, "reward_delivery": 0.0, "reward_collision": 0.0}
    env = VectorEnv("relay", robots=2, seed=1, actions=actions, **pays)
    observation = env.reset()
    low, high = env.layout.low, env.layout.high
    rng = np.random.default_rng(3)
    goals = Goals(env.arena, env.world.team)
    for _ in range(60):
        place, laden = env.world.state.pose[..., :2].copy(), env.world.state.held >= 0
        step = env.step(rng.integers(0, 5, (1, 2)))
        observation = step.observation
        assert (observation >= low).all()
        assert (observation <= high).all()
        gained = goals.sample(place) - goals.sample(env.world.state.pose[..., :2])
        toward = np.where(laden, gained[..., 0], gained[..., 1])[0]
        most = [sheet.top_speed * env.arena.timing.decision_period for sheet in env.world.team.sheets]
        np.testing.assert_allclose(step.reward[0], 0.5 * np.clip(toward / most, -1, 1), atol=1e-6)
