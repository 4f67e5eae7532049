"""Every page about a method opens with its equations and with one figure of the project's own."""

import re
import struct
from pathlib import Path

import pytest

from documentation.figures import FIGURES, __main__, canvas

METHODS = Path(__file__).parents[2] / "docs" / "methods"
PAGES = sorted(METHODS.glob("*.md"))
EQUATION = re.compile(r"^(?: {4}|\$\$).*=", re.MULTILINE)
OPENING = 40  # lines until the figure is shown


def picture_of(page):
    """Return caption and file of a page's only picture."""
    found = re.findall(
        r"^!\[([^\]]+)\]\(([^)]+)\)$", page.read_text(encoding="utf-8"), re.MULTILINE
    )
    assert len(found) == 1, page.name
    return found[0]


def test_every_page_has_a_figure_and_every_figure_a_page():
    assert [page.stem for page in PAGES] == list(FIGURES)
    assert {path.stem for path in METHODS.glob("*.png")} == set(FIGURES)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_opens_with_a_heading_equations_and_its_figure(page):
    text = page.read_text(encoding="utf-8")
    assert text.startswith("# ")
    before = text[: text.index("![")]
    assert EQUATION.search(before), "no equations before the figure"
    assert len(before.splitlines()) <= OPENING
    assert picture_of(page)[1] == f"{page.stem}.png"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_caption_is_one_sentence(page):
    caption, _ = picture_of(page)
    assert caption.endswith(".")
    assert not re.search(r"[.!?] [A-Z]", caption)


@pytest.mark.parametrize("page", FIGURES)
def test_a_figure_is_small_and_as_wide_as_a_page(page):
    drawn = (METHODS / f"{page}.png").read_bytes()
    assert len(drawn) <= 60_000
    assert struct.unpack(">I", drawn[16:20]) == (canvas.WIDTH * canvas.DOTS,)


def test_an_unknown_page_is_refused_with_the_pages_there_are(capsys):
    assert __main__.main(["nowhere"]) == 2
    assert "no page nowhere; pages: auto, " in capsys.readouterr().err


def test_the_same_curves_give_the_same_file(tmp_path):
    files = []
    for name in ("one", "two"):
        figure, (axes,) = canvas.panels(1)
        axes.plot([0.0, 1.0], [1.0, 0.0], label="flow")
        canvas.label(axes, "Title", "time, s", "flow Q, l/min")
        canvas.legend(axes)
        files.append(canvas.write(figure, name, tmp_path).read_bytes())
    assert files[0] == files[1]
