"""Parts of an HTML page: its style sheet, tables, text made safe."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

STYLE = """
:root { color-scheme: light dark; --paper: #fff; --ink: #1d2025; --quiet: #5c636d; --line: #dfe2e6;
  --tile: #f4f6f8; }
@media (prefers-color-scheme: dark) { :root { --paper: #16181c; --ink: #e8eaed; --quiet: #a3aab4;
  --line: #343941; --tile: #20242a; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 2.5rem 1.25rem 4rem; max-width: 62rem; background: var(--paper);
  color: var(--ink); font: 16px/1.55 system-ui, "Segoe UI", Roboto, Helvetica, Arial, sans-serif; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .4rem; letter-spacing: -.015em;
  overflow-wrap: anywhere; }
h2 { font-size: 1.25rem; margin: 3rem 0 .8rem; padding-top: .8rem; border-top: 1px solid var(--line); }
h3 { font-size: 1rem; margin: 0 0 .5rem; }
p { margin: .5rem 0; max-width: 46rem; }
code { font: .875em/1.5 ui-monospace, SFMono-Regular, Menlo, Consolas, monospace; overflow-wrap: anywhere; }
pre { background: var(--tile); border-radius: 6px; padding: .7rem .9rem; margin: .6rem 0;
  white-space: pre-wrap; }
.quiet, figcaption { color: var(--quiet); }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(11rem, 1fr)); gap: .75rem;
  margin: 1.5rem 0; }
.tiles div { background: var(--tile); border-radius: 8px; padding: .8rem 1rem; }
.tiles b { display: block; font-size: 1.45rem; line-height: 1.25; font-weight: 600; letter-spacing: -.01em; }
.tiles span { color: var(--quiet); font-size: .875rem; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .15rem 1.25rem; margin: 1rem 0; }
dt { color: var(--quiet); }
dd { margin: 0; overflow-wrap: anywhere; }
.figures { display: flex; flex-wrap: wrap; gap: 2rem 1.5rem; justify-content: space-between; }
figure { margin: 0; flex: 0 0 100%; break-inside: avoid; }
figure.narrow { flex: 1 1 24rem; max-width: 29rem; }
figure img { display: block; width: 100%; height: auto; background: #fff; border-radius: 6px; }
figcaption { font-size: .875rem; line-height: 1.45; margin-top: .5rem; max-width: 46rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .875rem; line-height: 1.4; }
table.small { width: auto; }
th, td { text-align: left; vertical-align: top; padding: .35rem .9rem .35rem 0;
  border-bottom: 1px solid var(--line); }
th { color: var(--quiet); font-weight: 600; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
td i { color: var(--quiet); font-style: normal; white-space: normal; }
@media print {
  :root { --paper: #fff; --ink: #000; --quiet: #444; --line: #bbb; --tile: #f2f2f2; }
  body { padding: 0; max-width: none; font-size: 10pt; }
  .tiles { grid-template-columns: repeat(4, 1fr); }
  figure.narrow { flex: 0 0 47%; max-width: 47%; }
  h2, h3 { break-after: avoid; }
  tr { break-inside: avoid; }
  .scroll { overflow: visible; }
}
"""


class Column(NamedTuple):
    """A column of a table, and its cells as HTML."""

    name: str
    cells: Sequence[str]
    is_number: bool = False


def table(columns: Sequence[Column], *, small: bool = False) -> str:
    """Return a table, as wide as the page unless `small`."""
    kinds = [' class="number"' if column.is_number else "" for column in columns]
    head = "".join(f"<th{kind}>{text(column.name)}</th>" for column, kind in zip(columns, kinds, strict=True))
    rows: Iterable[tuple[str, ...]] = zip(*(column.cells for column in columns), strict=True)
    body = "\n".join(
        "<tr>" + "".join(f"<td{kind}>{cell}</td>" for cell, kind in zip(row, kinds, strict=True)) + "</tr>"
        for row in rows
    )
    size = ' class="small"' if small else ""
    return (
        f'<div class="scroll"><table{size}>\n<thead><tr>{head}</tr></thead>\n'
        f"<tbody>\n{body}\n</tbody>\n</table></div>"
    )


def text(words: object) -> str:
    """Return text as HTML: it cannot be taken for markup."""
    return html.escape(str(words))


def code(words: str) -> str:
    """Return text as HTML, with what stands in backticks as code."""
    return re.sub(r"`([^`]*)`", r"<code>\1</code>", text(words))
