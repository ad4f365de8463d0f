import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robosim.arena.model import Zone
from robosim.discretise.modes import Mode, gripper_commands, modes
from robosim.world.state import Gripper
from tests.discretise.plain import mode_of
from tests.discretise.recorded import RUNS, recorded

FLOOR, HOME, SOURCE, TUNNEL = Zone.FLOOR, Zone.HOME, Zone.SOURCE, Zone.TUNNEL


@pytest.mark.parametrize(
    ("zone", "laden", "at_pellet", "mode"),
    [
        (HOME, False, False, Mode.EXIT_HOME),
        (HOME, False, True, Mode.EXIT_HOME),
        (FLOOR, False, False, Mode.GOING_TO_DIG),
        (TUNNEL, False, False, Mode.GOING_TO_DIG),
        (FLOOR, False, True, Mode.DIGGING),
        (TUNNEL, False, True, Mode.DIGGING),
        (SOURCE, False, False, Mode.DIGGING),
        (SOURCE, False, True, Mode.DIGGING),
        (SOURCE, True, False, Mode.EXIT_DIGGING),
        (TUNNEL, True, False, Mode.GOING_HOME),
        (FLOOR, True, False, Mode.GOING_HOME),
        (HOME, True, False, Mode.DUMPING),
    ],
)
def test_the_mode_follows_from_zone_load_and_pellet(
    zone: Zone, laden: bool, at_pellet: bool, mode: Mode
) -> None:
    got = modes(np.array([zone], dtype=np.uint8), np.array([laden]), np.array([at_pellet]))
    assert got.tolist() == [mode]


@given(st.integers(0, 2**32 - 1))
def test_a_batch_is_what_loops_say(seed: int) -> None:
    rng = np.random.default_rng(seed)
    zone = rng.integers(1, 5, (4, 7)).astype(np.uint8)
    laden, at_pellet = rng.random((2, 4, 7)) < 0.5
    got = modes(zone, laden, at_pellet)
    assert got.dtype == np.uint8
    for place in np.ndindex(4, 7):
        assert got[place] == mode_of(int(zone[place]), bool(laden[place]), bool(at_pellet[place]))


def test_grippers_take_in_digging_open_in_dumping_and_keep_otherwise() -> None:
    commands = gripper_commands(np.arange(len(Mode), dtype=np.uint8))
    expected = dict.fromkeys(Mode, Gripper.KEEP) | {Mode.DIGGING: Gripper.TAKE, Mode.DUMPING: Gripper.OPEN}
    assert {mode: commands[mode] for mode in Mode} == expected


# What can follow what: every mode may last, and a pellet may be lost at any time. Missing are the leaps:
# nobody on the way unladen is laden at once, and nobody gets from the home to the source in a decision.
NEXT = {
    Mode.EXIT_HOME: {Mode.GOING_TO_DIG, Mode.DIGGING},
    Mode.GOING_TO_DIG: {Mode.DIGGING, Mode.EXIT_HOME},
    Mode.DIGGING: {Mode.EXIT_DIGGING, Mode.GOING_HOME, Mode.DUMPING, Mode.GOING_TO_DIG, Mode.EXIT_HOME},
    Mode.EXIT_DIGGING: {Mode.GOING_HOME, Mode.DIGGING, Mode.GOING_TO_DIG},
    Mode.GOING_HOME: {Mode.DUMPING, Mode.EXIT_DIGGING, Mode.DIGGING, Mode.GOING_TO_DIG, Mode.EXIT_HOME},
    Mode.DUMPING: {Mode.EXIT_HOME, Mode.GOING_TO_DIG, Mode.DIGGING},
}


@pytest.mark.parametrize("name", RUNS)
def test_modes_follow_each_other_in_the_cycle_of_the_task(name: str) -> None:
    run = recorded(name)
    before = run.start.bare_mode
    for moment in run.moments:
        for old, new in zip(before.flat, moment.bare_mode.flat, strict=True):
            assert new == old or Mode(new) in NEXT[Mode(old)], (Mode(old).name, Mode(new).name)
        before = moment.bare_mode


@pytest.mark.parametrize("name", RUNS)
def test_collision_overlays_a_mode_and_gives_it_back(name: str) -> None:
    """The mode underneath goes on by itself: whoever is freed shows what he would have shown anyway."""
    for moment in recorded(name).moments:
        assert (moment.bare_mode != Mode.COLLISION).all()
        assert ((moment.mode == Mode.COLLISION) == moment.blocked).all()
        assert (moment.mode == moment.bare_mode)[~moment.blocked].all()
