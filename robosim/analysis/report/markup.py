"""Text and tables to HTML, by the templates beside this module; all that is not `Markup` is escaped."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup


class Column(NamedTuple):
    """A column of a table. Its cells are text, or `Markup` where they have tags of their own."""

    name: str
    cells: Sequence[str]
    is_number: bool = False


def rendered(template: str, **content: object) -> str:
    """Return a template of this package, filled in."""
    return _environment().get_template(template).render(content)


def code(words: str) -> Markup:
    """Return text as code."""
    return Markup("<code>{}</code>").format(words)


def backticks_as_code(words: str) -> Markup:
    """Return text with what stands in backticks as code."""
    parts = words.split("`")
    return Markup("").join(code(part) if number % 2 else part for number, part in enumerate(parts))


@functools.cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("robosim.analysis.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["transposed"] = _transposed
    return environment


def _transposed(columns: Iterable[Sequence[str]]) -> list[tuple[str, ...]]:
    return list(zip(*columns, strict=True))
