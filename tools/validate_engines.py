"""Measure what the data sheet determines in both engines, beside the closed form; a table in Markdown.

python tools/validate_engines.py
"""

from __future__ import annotations

from robosim.deploy.mujoco.validation import ENGINES, EXPERIMENTS


def main() -> None:
    print(f"| what | closed form | expected | {' | '.join(ENGINES)} |\n|---|---|---|---|---|")
    for one in EXPERIMENTS:
        found = " | ".join(f"{one.measure(engine):.4g}" for engine in ENGINES.values())
        print(f"| {one.name}, {one.unit} | {one.form} | {one.expected:.4g} | {found} |", flush=True)


if __name__ == "__main__":
    main()
