"""Same seed, same actions, same bits: in any process, whatever its memory looks like."""

import subprocess
import sys

import pytest

SCRIPT = """
import hashlib, sys
import numpy as np
from robosim.control.lanes import LanesController
from robosim.envs.vector import VectorEnv

arena, decisions, disturbed = sys.argv[1], int(sys.argv[2]), sys.argv[3] == "disturbed"
junk = []
if disturbed:
    import pymunk
    rng = np.random.default_rng()
    junk = [bytearray(int(size)) for size in rng.integers(1, 5000, 20000)]
    del junk[::3]
    other = VectorEnv("long", robots=5, num_envs=2, seed=9)
    other.reset()
    junk.append([pymunk.Body(1.0, 1.0) for _ in range(777)])
env = VectorEnv(arena, robots=8, seed=7, episode_steps=1200)
controller = LanesController()
observation = env.reset()
controller.reset(env)
rng = np.random.default_rng(1)
digest = hashlib.sha256(observation.tobytes())
delivered = 0
for decision in range(decisions):
    actions = controller.act(env, observation)
    chance = rng.integers(0, 5, actions.shape)
    # The chance is drawn for everybody, and taken where it is 0 in five.
    actions = np.where(rng.random(actions.shape) < 0.2, chance, actions)
    if disturbed and decision % 50 == 0:
        other.step(np.zeros((2, 5), dtype=int))
        junk.append(bytearray(int(decision) * 7 + 1))
    transition = env.step(actions)
    observation = transition.observation
    state, contacts = env.world.state, env.world.contacts
    delivered += int(state.deliveries.sum())
    for array in (
        actions, observation, transition.reward, state.pose, state.velocity, state.pellets,
        state.pellet_status, state.held, state.touched, env.dec_pomdp.pheromone.occupancy,
        contacts.time, contacts.kind, contacts.a, contacts.b, contacts.position, contacts.impulse,
    ):
        digest.update(np.ascontiguousarray(array).tobytes())
    if (decision + 1) % 250 == 0:
        print(decision + 1, digest.hexdigest())
print("delivered", delivered)
"""


@pytest.mark.parametrize("decisions", [500, pytest.param(3000, marks=pytest.mark.slow)])
def test_two_processes_agree_to_the_last_bit(decisions) -> None:
    """Eight robots and their pellets; one process has its memory littered and a second world running."""
    runs = [
        subprocess.Popen(
            [sys.executable, "-c", SCRIPT, arena, str(length), how], stdout=subprocess.PIPE, text=True
        )
        for arena, length in (("paper", decisions), ("three-wide", 500))
        for how in ("plain", "disturbed")
    ]
    printed = [run.communicate()[0].splitlines() for run in runs]
    assert [run.returncode for run in runs] == [0, 0, 0, 0]
    for plain, disturbed in (printed[:2], printed[2:]):
        for line, other in zip(plain, disturbed, strict=True):
            print(line[:40], line == other)
            assert line == other
    assert len(printed[0]) == decisions // 250 + 1
    assert int(printed[0][-1].split()[1]) > decisions // 60
