"""Hooks of mkdocs: pages from beside docs/, files that pages link to, and nothing loaded from elsewhere."""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import TYPE_CHECKING

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
PAGES = {"README.md": "index.md", "CHANGELOG.md": "changes.md", "CONTRIBUTING.md": "contributing.md"}
"""Pages of the site that are not in docs/, by where they are in the repository."""
FILES = "repository"
"""Folder of the site for files of the repository that are no pages."""
_LINK = re.compile(r"(\[[^\]]*\]|!\[[^\]]*\])\((?!https?:|#|mailto:)([^)\s#]+)(#[^)\s]*)?\)")
_LOADED = re.compile(
    r"""<(?:script|img|iframe|source)\b[^>]*\bsrc=["']?(?:https?:)?//[^>]*>|<link\b[^>]*>|@import[^;]*;"""
)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that lie outside of docs/."""
    for name, page in PAGES.items():
        files.append(File.generated(config, page, content=(ROOT / name).read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links to where their targets are in the site, adding files of the repository as they are met."""
    source = {to: name for name, to in PAGES.items()}.get(page.file.src_uri, f"docs/{page.file.src_uri}")

    def led(match: re.Match[str]) -> str:
        text, link, anchor = match.groups()
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), link))
        return (
            f"{text}({_place(target, config, files)}{anchor or ''})"
            if _place(target, config, files)
            else text[1:-1]
        )

    return _LINK.sub(led, markdown)


def _place(target: str, config: MkDocsConfig, files: Files) -> str | None:
    """Return where a file of the repository is in the site, as pages link to it; None for a folder."""
    if target in PAGES:
        return PAGES[target]
    if (ROOT / target).is_dir():
        return None
    if target.startswith("docs/"):
        return target.removeprefix("docs/")
    place = f"{FILES}/{target}"
    if place not in files.src_uris and (ROOT / target).is_file():
        files.append(File.generated(config, place, abs_src_path=str(ROOT / target)))
    return place


def on_post_page(output: str, page: Page, **_: object) -> str:
    """Refuse a page that would load anything from another host."""
    for tag in _LOADED.findall(output):
        if re.search(r"(?:https?:)?//", tag) and 'rel="canonical"' not in tag:
            raise PluginError(f"{page.file.src_uri} loads something from elsewhere: {tag[:200]}")
    return output
