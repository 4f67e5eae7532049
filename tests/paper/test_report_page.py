"""The report as a whole: one page that stands alone, the same numbers as JSON, one command."""

import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from paper.motion import Motion
from paper.page import figure_text
from paper.picture import MOST, numbers
from paper.source_types import FORMS, TIMES, SourceTypes
from valvemap.cli import run

SETS = 2
NAMES = ("PI alone", "table", "fixed map", "living map")
ERRORS = {
    case: dict(zip(NAMES, errors, strict=True))
    for case, errors in {
        "new": (24.0, 4.0, 1.0, 1.0),
        "supply -22 %": (31.0, 7.0, 3.0, 3.0),
        "two edges -30 %, 60 s later": (24.0, 3.7, 1.6, 0.8),
    }.items()
}

TYPES = SourceTypes({time: dict.fromkeys(FORMS, 1.0) for time in TIMES}, dict.fromkeys(FORMS, 1.0))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("new") / "reports"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Motion, "measured", lambda *_: Motion(ERRORS))
        patch.setattr(SourceTypes, "measured", lambda *_: TYPES)
        assert run(["report", "--out", str(folder), "--sets", str(SETS), "--rate", "2"]) == 0
    return folder


@pytest.fixture(scope="module")
def text(folder):
    return (folder / "paper.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def content(folder):
    return json.loads(
        (folder / "paper.json").read_text(encoding="utf-8"), parse_constant=pytest.fail
    )


class Page(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.links, self.ids, self.images, self.open = [], set(), [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.links += [attributes[name] for name in ("href", "src") if name in attributes]
        self.ids.add(attributes.get("id"))
        if tag == "img":
            self.images.append(attributes)
        if tag in {"table", "section", "figure", "ul", "tbody", "p"}:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if self.open and self.open[-1] == tag:
            self.open.pop()


def test_the_page_stands_alone(text):
    page = Page(text)
    assert page.links
    assert all(link.startswith(("data:image/png;base64,", "#")) for link in page.links)
    assert {link[1:] for link in page.links if link.startswith("#")} <= page.ids
    assert not re.search(r"https?://|<script|@import|url\(", text)
    assert page.open == []
    assert not re.search(r"\$[a-z]", text)


def test_the_page_shows_every_picture_claim_and_misprint(text, content):
    page = Page(text)
    assert len(page.images) == len(content["pictures"]) == 10
    assert all(image["alt"] for image in page.images)
    assert {f"claim-{k}" for k in range(1, 16)} | set(content["pictures"]) <= page.ids
    assert text.count("fails</span>") == sum(e["printed_fails"] for e in content["errata"])


def test_the_page_tells_the_verdicts_of_the_json(text, content):
    rows = re.findall(
        r'#claim-(\d+)">\d+</a></td>.*?class="badge \w+">([^<]*)</span></td>'
        rf"<td class=num>(\d) of [1{SETS}]</td><td>(.*?)</td></tr>",
        text,
    )
    for row, claim, faster in zip(
        rows, content["claims"], content["claims_at_the_faster_rate"], strict=True
    ):
        agreeing = str(claim["sets_with_the_same_verdict"])
        assert row[:3] == (str(claim["number"]), claim["verdict"], agreeing)
        same = faster["verdict"] == claim["verdict"]
        assert row[3] == "the same" if same else faster["verdict"] in row[3]


def test_the_papers_figures_and_tables_are_files_too(folder, content):
    for key in ("figure-4", "figure-7", "figure-8", "figure-9", "table-1", "table-2"):
        assert key in content["pictures"]
    for key in content["pictures"]:
        picture = (folder / f"{key}.png").read_bytes()
        assert picture.startswith(b"\x89PNG")
        assert len(picture) > 10_000


def test_the_json_holds_every_figure_of_every_set(content):
    assert [claim["number"] for claim in content["claims"]] == list(range(1, 16))
    assert content["recordings"] == {
        "sets": SETS,
        "samples": 440,
        "rate_hz": 2.0,
        "faster_rate_hz": 20.0,
    }
    *of_sets, of_motion, of_data = content["claims"]
    for claim in (of_motion, of_data):
        assert all(len(part["values"]) == 1 for part in claim["parts"])
    for claim in of_sets:
        assert all(len(part["values"]) == SETS for part in claim["parts"])
        assert all(part["why"] for part in claim["parts"])


def test_the_json_holds_the_numbers_of_the_pictures(content):
    sweep = content["pictures"]["lambda-sweep"]["series"]["structured"]
    assert len(sweep["lam"]) == len(sweep["unrest"]) == len(sweep["unrest_as_printed"])
    for picture in content["pictures"].values():
        for series in picture["series"].values():
            assert 0 < max(map(len, series.values())) <= MOST


def test_numbers_are_thinned_and_what_is_not_finite_is_none():
    drawn = numbers(x=np.r_[np.arange(999.0), np.inf])
    assert len(drawn["x"]) == MOST
    assert numbers(x=[np.inf])["x"] == [None]


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "–"), (np.nan, "–"), (np.inf, "∞"), (10_000.0, "10,000"), (1e-8, "1e-08"), (0.0, "0")],
)
def test_figures_are_spelt_shortly(value, text):
    assert figure_text(value) == text


def test_a_folder_that_cannot_be_made_is_named_before_anything_is_computed(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert run(["report", "--out", str(tmp_path / "file" / "reports")]) == 1
    assert "reports: not a directory" in capsys.readouterr().err
