"""Pages: Python for newcomers runs, links and anchors lead somewhere, the site knows every page."""

import ast
import itertools
import re
import shlex
import tomllib
from pathlib import Path

import pytest

import robosim
from robosim.cli.main import parse

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.glob("*.md"))]
LINK = re.compile(r"(?<!`)\]\((?!https?:)([^)\s#]*)(?:#([^)\s]+))?\)")


def anchors(page: Path) -> set[str]:
    """What the headings of a page are called in links, as both GitHub and mkdocs write it."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    headings = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
    plain = [re.sub(r"[^\w\s-]", "", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", one)) for one in headings]
    return {re.sub(r"\s+", "-", one.strip().lower()) for one in plain}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_and_their_anchors_lead_somewhere(page) -> None:
    for link, anchor in LINK.findall(page.read_text(encoding="utf-8")):
        target = (page.parent / link).resolve() if link else page
        assert target.exists(), link
        if anchor and target.suffix == ".md" and not anchor.startswith("robosim."):
            assert anchor in anchors(target), f"{link}#{anchor}"


def python_of(page) -> list[str]:
    return re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize(("name", "blocks"), [("first-hour", 1), ("extending", 3)])
def test_the_python_of_a_page_runs(name, blocks, capsys) -> None:
    found = python_of(DOCS / f"{name}.md")
    assert len(found) == blocks
    code = (
        "\n".join(found).replace("episode_steps=200", "episode_steps=60").replace("range(200)", "range(60)")
    )
    exec(compile(code, name, "exec"), {})
    assert len(capsys.readouterr().out.splitlines()) == blocks


def test_every_page_is_in_the_navigation_of_the_site() -> None:
    named = set(
        re.findall(r": ([\w-]+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE)
    )
    assert named == {page.name for page in DOCS.glob("*.md")} | {"index.md", "changes.md", "contributing.md"}


def test_the_names_that_robosim_offers_are_on_the_page_of_the_api() -> None:
    page = (DOCS / "api.md").read_text(encoding="utf-8")
    assert [
        name for name in robosim.__all__ if name != "__version__" and f"`robosim.{name}`" not in page
    ] == []


def imports(code: str) -> set[tuple[str, str]]:
    """Return modules of robosim, and the names that a text of Python imports from them."""
    return {
        (node.module, alias.name)
        for node in ast.walk(ast.parse(code))
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("robosim.")
        for alias in node.names
    }


def home(module: str, name: str) -> str:
    """Return the module that a package has a name from; a module has its own."""
    package = ROOT / module.replace(".", "/") / "__init__.py"
    within = imports(package.read_text(encoding="utf-8")) if package.exists() else set()
    return next((inner for inner, one in within if one == name), module)


def test_what_the_pages_import_is_on_the_page_of_the_api() -> None:
    """What users are told to import is public: it stands there, under its own module."""
    page = (DOCS / "api.md").read_text(encoding="utf-8")
    parts = re.findall(r"^::: (\S+)\n(?:    options:\n      members: \[(.*)\])?", page, re.MULTILINE)
    public = {module: members.split(", ") for module, members in parts}
    codes = itertools.chain.from_iterable(map(python_of, PAGES))
    found = {(home(*one), one[1]) for code in codes for one in imports(code)}
    assert len(found) > 30
    assert {
        (module, name)
        for module, name in found
        if module not in public or (public[module] != [""] and name not in public[module])
    } == set()


def test_versions_agree() -> None:
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {robosim.__version__}\n" in citation
    assert f"({robosim.__version__})" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_each_python_that_is_claimed_is_in_the_matrix() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    claimed = re.findall(r"Python :: (3\.\d+)", " ".join(project["classifiers"]))
    workflow = (ROOT / ".github" / "workflows" / "tests.yml").read_text(encoding="utf-8")
    assert f"python: {claimed}".replace("'", '"') in workflow


@pytest.mark.slow
def test_the_command_line_understands_every_command_of_the_pages() -> None:
    understood = 0
    for page in PAGES:
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        for line in re.findall(r"^    (robosim .*)$", text, flags=re.MULTILINE):
            # What a comment says, and what a list says behind wide gaps.
            command = re.split(r"\s#|\s{5,}", line)[0]
            # Without those that have a variable of the shell, leave something open, or only print.
            if not re.search(r"\$|\.\.\.| [A-Z]+\b|--version|--tyro", command):
                parse(shlex.split(command)[1:])
                understood += 1
    assert understood > 100
