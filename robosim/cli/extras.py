"""What an installation may leave out, and how to add it."""

from __future__ import annotations

EXTRAS: dict[str, tuple[str, ...]] = {
    "train": ("torch", "tensorboard", "tomli_w"),
    "view": ("rerun", "rerun_cli"),
    "video": ("av",),
    "report": ("jinja2", "matplotlib"),
    "deploy": ("onnx", "onnxruntime", "zenoh"),
    "mujoco": ("mujoco",),
    "cluster": ("ray",),
}
"""Modules that each extra of the package alone brings."""
_SHARED = {"pyarrow": "train` or `report", "PIL": "video` or `report"}
"""Modules that two of them bring."""


def missing_extra(module: str) -> str | None:
    """Return, in a sentence, which extra brings `module`; None for a module that none of them brings."""
    top = module.partition(".")[0]
    if top in _SHARED:
        return _sentence(top, _SHARED[top])
    for extra, modules in EXTRAS.items():
        if top in modules:
            return _sentence(top, extra)
    return None


def _sentence(module: str, extra: str) -> str:
    first = extra.partition("`")[0]
    return (
        f"this needs {module}, which is not installed: install robosim with its extra `{extra}`, "
        f"in a checkout by: pip install '.[{first}]'."
    )
