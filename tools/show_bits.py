"""Show which numbers are equal to the bit, by a digest of each: run it on two machines and compare.

    python tools/show_bits.py
    python tools/show_bits.py --compare

`--compare` runs itself under settings with which libraries compute as they do on other x86 processors, and
prints in Markdown what differs from this one. A setting that a library does not know changes nothing.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray

from robosim.control.policy import load_policy
from robosim.envs.vector import VectorEnv
from robosim.learning.computing import one_thread
from robosim.learning.config import RunConfig, run_config
from robosim.learning.training import Training

SETTINGS = {
    "numpy without AVX-512": {"NPY_DISABLE_CPU_FEATURES": "AVX512_SPR AVX512_ICL X86_V4"},
    "numpy without AVX2": {"NPY_DISABLE_CPU_FEATURES": "AVX512_SPR AVX512_ICL X86_V4 X86_V3"},
    "glibc without FMA": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-FMA4,-AVX2,-AVX512F"},
    "OpenBLAS as with AVX2": {"OPENBLAS_CORETYPE": "Haswell"},
    "OpenBLAS as on AMD": {"OPENBLAS_CORETYPE": "Zen"},
    "OpenBLAS as on Intel with AVX-512": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "torch as with AVX2": {"ATEN_CPU_CAPABILITY": "avx2"},
    "torch as without AVX2": {"ATEN_CPU_CAPABILITY": "default"},
    "MKL as anywhere": {"MKL_CBWR": "COMPATIBLE"},
    "oneDNN as with AVX2": {"ONEDNN_MAX_CPU_ISA": "AVX2"},
}
STEPS = 400


def digests() -> Iterator[tuple[str, str]]:
    """Yield what is computed, and a digest of its bits."""
    x, y = np.random.default_rng(0).uniform(-20.0, 20.0, (2, 4099))
    yield "sine, cosine", _digest(np.sin(x), np.cos(x))
    yield "arctan2", _digest(np.arctan2(x, y))
    yield "exponential", _digest(np.exp(x))
    yield from run()
    policy = load_policy("paper-4")
    observation = VectorEnv("paper", robots=4, num_envs=64, stigmergy=True, seed=1).reset()
    yield "action values", _digest(policy.values(observation))
    yield "greedy actions", _digest(policy.act(observation))
    tiny = {
        "robots": 2, "num_envs": 2, "steps": 1200, "warmup": 100, "episode_steps": 300,
        "pellet_gradient": 0.0,
    }  # fmt: skip
    for technique in ("iql+s", "ps-dqn"):
        yield f"training, {technique}", _digest(*trained(run_config(technique, **tiny)))


def run() -> Iterator[tuple[str, str]]:
    """Yield digests of what four robots do that take turns in where they go."""
    env = VectorEnv("paper", robots=4, num_envs=2, seed=5)
    rng, seen, moved, paid = np.random.default_rng(9), [env.reset()], [], []
    for step in range(STEPS):
        drawn = rng.integers(5, size=(2, 4))
        transition = env.step(np.where(rng.random((2, 4)) < 0.3, drawn, step // 20 % 4))
        seen.append(transition.observation)
        paid.append(transition.reward)
        moved.append(np.concatenate((env.world.state.pose, env.world.state.velocity), axis=2))
    yield "poses and velocities", _digest(*moved)
    yield "observations", _digest(*seen)
    yield "rewards", _digest(*paid)


def trained(config: RunConfig) -> list[NDArray[np.float32]]:
    """Return the weights of a team that has learned for a little while."""
    training = Training(config)
    with one_thread():
        while not training.finished:
            training.advance()
    return [array for _, array in sorted(training.actors().weights.items())]


def _digest(*arrays: NDArray[np.generic]) -> str:
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()[
        :12
    ]


def compare() -> Iterator[str]:
    """Yield the lines of a table: what differs under each of the settings."""
    plain = _elsewhere({})
    yield "| setting | differs |"
    yield "|---|---|"
    for name, variables in SETTINGS.items():
        there = _elsewhere(variables)
        changed = [what for what, digest in plain.items() if there[what] != digest]
        set_by = " ".join(f'{key}="{value}"' for key, value in variables.items())
        yield f"| {name}: `{set_by}` | {', '.join(changed) or 'nothing'} |"


def _elsewhere(variables: dict[str, str]) -> dict[str, str]:
    here = [sys.executable, __file__]
    lines = subprocess.run(
        here, env=os.environ | variables, capture_output=True, text=True, check=True
    ).stdout
    return dict(line.rsplit("  ", 1) for line in lines.splitlines())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--compare", action="store_true")
    torch.set_num_threads(1)
    if parser.parse_args().compare:
        for line in compare():
            print(line, flush=True)
        return
    for name, digest in digests():
        print(f"{name}  {digest}", flush=True)


if __name__ == "__main__":
    main()
