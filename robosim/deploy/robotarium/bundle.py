"""Modules of robosim as flat files that need no robosim: the same source, with other names in the imports."""

from __future__ import annotations

import ast
import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path

import robosim

PLAIN = "robosim.deploy.robotarium.plain"
_STAND_INS = {"pydantic": PLAIN, "robosim.records": PLAIN}
_OUTSIDE = {"numpy", "rps"}
"""What the laboratory has, and what it is; matplotlib is not imported, its axes are handed over."""
_TOO_NEW = {("typing", "Self")}
"""What Python 3.10 lacks of the standard library, and `plain` has."""


def flat_files(module: str, name: str) -> dict[str, str]:
    """Return the source of a module, as the file `name`, and of all that it imports, by file name.

    RuntimeError for what cannot be made flat: it is a mistake in robosim.
    """
    files: dict[str, str] = {}
    waiting, seen = [module], {module}
    while waiting:
        current = waiting.pop()
        text, needed = _flattened(current)
        files[name if current == module else f"{_flat(current)}.py"] = text
        new = [one for one in needed if one not in seen]
        seen.update(new)
        waiting += new
    return files


def _flat(module: str) -> str:
    return module.replace(".", "_")


def _flattened(module: str) -> tuple[str, list[str]]:
    """Return a module's source with flat imports, and the modules of robosim that it imports as it runs."""
    source = _path_of(module).read_text(encoding="utf-8")
    lines = source.splitlines()
    needed = []
    # From the last to the first, so that the lines before keep their numbers.
    for node, runs in reversed(list(_imports(ast.parse(source), runs=True))):
        statements = list(_rewritten(node, module))
        indent = " " * node.col_offset
        lines[node.lineno - 1 : node.end_lineno] = [indent + text for text, _ in statements]
        needed += [origin for _, origin in statements if runs and origin]
    note = f"# From robosim {robosim.__version__}: {module}"
    return "\n".join([note, *lines, ""]), needed


def _path_of(module: str) -> Path:
    spec = importlib.util.find_spec(module)
    if spec is None or spec.origin is None or spec.submodule_search_locations is not None:
        raise RuntimeError(f"{module} is not a module of one file")
    return Path(spec.origin)


def _imports(tree: ast.AST, *, runs: bool) -> Iterator[tuple[ast.Import | ast.ImportFrom, bool]]:
    """Yield all imports in order, and whether they run: those for types alone do not."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node, runs
        else:
            for_types = isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
            yield from _imports(node, runs=runs and not for_types)


def _rewritten(node: ast.Import | ast.ImportFrom, module: str) -> Iterator[tuple[str, str]]:
    """Yield the statements that take the place of an import, and the module of robosim that each is of."""
    if isinstance(node, ast.Import):
        for alias in node.names:
            _require_known(alias.name, module)
        yield ast.unparse(node), ""
        return
    source = node.module or ""
    inside = _STAND_INS.get(source, source)
    if inside.partition(".")[0] == "robosim":
        yield _import(_flat(inside), node.names), inside
        return
    _require_known(source, module)
    new = [alias for alias in node.names if (source, alias.name) in _TOO_NEW]
    old = [alias for alias in node.names if alias not in new]
    if old:
        yield _import(source, old), ""
    if new:
        yield _import(_flat(PLAIN), new), PLAIN


def _import(source: str, names: list[ast.alias]) -> str:
    return ast.unparse(ast.ImportFrom(source, names, 0))


def _require_known(name: str, module: str) -> None:
    top = name.partition(".")[0]
    if top not in _OUTSIDE and top not in sys.stdlib_module_names:
        raise RuntimeError(f"{module} imports {name}, which the laboratory does not have")
