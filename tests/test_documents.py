"""What the documents point at is there."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_link_leads_somewhere(document):
    targets = re.findall(r"\]\(([^)#\s]+)", document.read_text(encoding="utf-8"))
    local = [target for target in targets if not target.startswith("http")]
    assert [target for target in local if not (document.parent / target).exists()] == []


def test_the_architecture_names_no_room_that_is_not_there():
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    rooms = re.findall(r"`((?:service|virtual_rig|paper|tests)/[\w/.]*)`", text)
    assert [room for room in rooms if not (ROOT / room).exists()] == []


def test_the_architecture_begins_with_modules_that_are_there():
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8").split("## Packages", 1)[1]
    rows = re.findall(r"^\| `(\w+)/?` \|[^|]*\|([^|]*)\|$", text, re.MULTILINE)
    packages = {path.name: path for path in (ROOT / "service").glob("*/*") if path.is_dir()}
    named = [
        packages[package] / f"{module}.py"
        for package, cell in rows
        for module in re.findall(r"`(\w+)`", re.sub(r"\([^)]*\)", "", cell))
    ]
    assert [module for module in named if not module.exists()] == []
    assert len(named) > 40
