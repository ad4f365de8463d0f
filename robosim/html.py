"""What objects show of themselves in a notebook: small tables, without scripts or styles from elsewhere."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

from robosim.errors import printable

_LONGEST = 200
"""Characters of a value that are shown."""
_LEFT = 'style="text-align:left"'


def facts_html(title: str, facts: Iterable[tuple[str, object]], picture: str = "") -> str:
    """Return a title, a picture and a table of (name, value).

    Title, names and values are escaped and cut, for they may come from strangers; `picture` is markup as it
    stands. Facts whose value is None or an empty text are left out.
    """
    rows = "".join(
        f"<tr><th {_LEFT}>{_safe(name)}</th><td {_LEFT}>{_safe(value)}</td></tr>"
        for name, value in facts
        if value not in (None, "")
    )
    return f"<div><strong>{_safe(title)}</strong>{picture}<table>{rows}</table></div>"


def _safe(value: object) -> str:
    """Return a value as printable text that holds no markup."""
    return escape(printable(str(value), _LONGEST))
