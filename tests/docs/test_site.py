"""The documentation site builds strictly, has every page, and loads nothing from elsewhere."""

import doctest
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

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
    for said in ("recursive_least_squares", "FlowMapRegressor", "SlidingWindow", "Regressors."):
        assert said in text


def test_what_the_explanation_shows_is_so():
    explanation = ROOT / "docs" / "explanation.md"
    tried = doctest.testfile(str(explanation), module_relative=False, encoding="utf-8")
    assert tried.attempted > 15
    assert tried.failed == 0
