"""Export every policy that ships, and compare onnxruntime with robosim on real observations.

    python tools/check_export.py                         # all policies, 10,000 observations each
    python tools/check_export.py paper-8 --observations 1000

Prints a line for each policy, and fails if an action differs, or a value by more than 1e-5.
"""

from __future__ import annotations

import argparse
import sys

from robosim.control.policy import find_policy, policy_names, read_policy
from robosim.deploy.export import agreement, onnx_model, real_observations
from robosim.deploy.runtime import OnnxPolicy


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("policies", nargs="*", help="names or folders; by default all that ship")
    parser.add_argument("--observations", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    failed = 0
    for name in options.policies or policy_names():
        folder = find_policy(name)
        policy = read_policy(folder)
        model = onnx_model(folder, name)
        found = agreement(
            OnnxPolicy(model), policy, real_observations(policy, name, options.observations, options.seed)
        )
        failed += not found.holds
        print(f"{name:<16}{len(model) / 1e6:6.2f} MB  {'ok ' if found.holds else 'NOT'}  {found}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
