"""The documentation site builds strictly, has every page, and loads nothing from elsewhere."""

import doctest
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import valvemap

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder


def test_every_document_is_a_page(site):
    documents = (ROOT / "docs").rglob("*.md")
    expected = {d.relative_to(ROOT / "docs").with_suffix(".html") for d in documents}
    assert expected <= {page.relative_to(site) for page in site.rglob("*.html")}


def test_no_page_loads_anything_from_elsewhere(site):
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(
            r"<(?:script|link|img|iframe)\b[^>]*?(?:src|href)=\"?(https?:[^\" >]+)", text
        )
        assert loaded == [], page


def test_formulas_are_drawn_by_the_browser_alone(site):
    text = (site / "explanation.html").read_text(encoding="utf-8")
    assert text.count("<math") > 10
    assert "arithmatex" not in text


def test_the_python_reference_has_what_the_docstrings_say(site):
    text = (site / "reference" / "python.html").read_text(encoding="utf-8")
    titles = set(re.findall(r'<h3 id="valvemap\.[\w.]+\.(\w+)"', text))
    assert set(valvemap.__all__) - {"__version__"} <= titles
    assert "Regressors." in text


@pytest.mark.parametrize(("page", "least"), [("explanation.md", 15), ("reference/python.md", 3)])
def test_what_a_page_shows_is_so(page, least):
    tried = doctest.testfile(str(ROOT / "docs" / page), module_relative=False, encoding="utf-8")
    assert tried.attempted > least
    assert tried.failed == 0
