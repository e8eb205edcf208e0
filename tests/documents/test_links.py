"""Links between documents lead somewhere; `make docs` checks them too, but not those of the README."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCUMENTS = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *(path for path in sorted((ROOT / "docs").rglob("*.md")) if "_build" not in path.parts),
]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_file_that_a_document_links_to_is_there(document: Path) -> None:
    text = re.sub(r"```.*?```|`[^`]*`", "", document.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
        assert target.startswith("https://") or (document.parent / target).exists(), target
    for target in re.findall(r"\{include\} (\S+)", document.read_text(encoding="utf-8")):
        assert (document.parent / target).is_file(), target


def test_every_page_is_in_the_table_of_contents() -> None:
    pages = {path.relative_to(ROOT / "docs").with_suffix("").as_posix() for path in DOCUMENTS[3:]}
    listed = {"index"}
    for page in pages:
        blocks = re.findall(r"```\{toctree\}\n(.*?)```", (ROOT / "docs" / f"{page}.md").read_text(), re.DOTALL)
        folder = Path(page).parent
        entries = [line for block in blocks for line in block.splitlines() if line and not line.startswith(":")]
        listed |= {(folder / entry).as_posix() for entry in entries}
    assert listed == pages
