"""The README's Python runs as it stands, and its links lead somewhere."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_python_of_the_readme_runs(capsys) -> None:
    blocks = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    assert len(blocks) == 2
    exec(compile("\n".join(blocks), "README.md", "exec"), {})
    delivered = [int(number) for number in re.findall(r"\d+", capsys.readouterr().out)]
    assert len(delivered) == 16
    assert all(number > 10 for number in delivered)


def test_links_lead_to_files() -> None:
    links = re.findall(r"\]\((?!http)([^)#]+)\)", README)
    assert len(links) >= 5
    for page in [README, *(path.read_text(encoding="utf-8") for path in (ROOT / "docs").glob("*.md"))]:
        where = ROOT if page is README else ROOT / "docs"
        for link in re.findall(r"\]\((?!http)([^)#]+)\)", page):
            assert (where / link).exists(), link
