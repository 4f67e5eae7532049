"""The reference pages say what models, commands and a running server say now."""

import re

import pytest

from documentation.configuration import undescribed
from documentation.pages import REFERENCE, pages
from valvemap.cli import COMMANDS

DOCS = REFERENCE.parent
ROOT = DOCS.parent


@pytest.fixture(scope="module")
def made():
    return pages()


@pytest.mark.parametrize(
    "name", ["address_space.md", "commands.md", "configuration.md", "vocabulary.md"]
)
def test_a_reference_page_is_what_would_be_made_now(made, name):
    kept = (REFERENCE / name).read_text(encoding="utf-8")
    assert kept == made[name], "run `make reference`, and look at what has changed"


def test_every_field_of_the_configuration_says_what_it_means():
    assert undescribed() == []


def test_every_command_has_its_place(made):
    titles = re.findall(r"^## `valvemap (.+)`", made["commands.md"], re.MULTILINE)
    assert titles == list(COMMANDS)


def test_every_node_that_a_document_names_is_there(made):
    known = {
        owner + node
        for owner, rows in re.findall(
            r"^## `(.+?)`\n(.*?)(?=^## |\Z)", made["address_space.md"], re.MULTILINE | re.DOTALL
        )
        for node in re.findall(r"^\| `(\.\w+)`", rows, re.MULTILINE)
    }
    for _ in range(2):  # their owners, and the owners of these
        known |= {node.rpartition(".")[0] for node in known}
    assert len(known) > 60
    for document in sorted([*(DOCS / "how-to").glob("*.md"), DOCS / "tutorial.md"]):
        text = document.read_text(encoding="utf-8")
        for name in re.findall(r"s=(Valvistor[\w.]+\w|Service[\w.]+\w)", text):
            general = re.sub(r"^Valvistor", "<Valve>", name)
            general = re.sub(r"^<Valve>\.(RLS|RML|RBF|Auto)\.", "<Valve>.<Estimator>.", general)
            assert general in known, f"{document.name}: {name}"


def test_every_command_that_a_document_names_is_there():
    for document in sorted([ROOT / "README.md", *DOCS.rglob("*.md")]):
        text = document.read_text(encoding="utf-8")
        for name in re.findall(r"^\$? ?valvemap ([a-z][\w-]*)", text, re.MULTILINE):
            assert name in COMMANDS, f"{document.name}: valvemap {name}"
