"""The bill of materials has all that the image has, and is valid CycloneDX."""

import json
import re

import pytest

from documentation.bill_of_materials import LOCK, bill_of_materials
from support.bills import complaint_of


@pytest.fixture(scope="module")
def bill():
    return bill_of_materials()


def test_it_is_valid_cyclonedx(bill):
    assert complaint_of(bill) is None


def test_every_locked_package_is_there_with_its_digests(bill):
    there = {c["purl"]: c.get("hashes", []) for c in json.loads(bill)["components"]}
    lock = LOCK.read_text(encoding="utf-8")
    pinned = re.findall(r"^([\w.-]+)==([^\s;]+)", lock, re.MULTILINE)
    assert len(pinned) > 20
    for name, version in pinned:
        assert there[f"pkg:pypi/{name.lower()}@{version}"], name
    assert sum(map(len, there.values())) >= lock.count("--hash=sha256:")


def test_the_page_s_vendored_scripts_are_there_with_their_licences(bill):
    there = {c["purl"]: c for c in json.loads(bill)["components"]}
    for purl in ("pkg:npm/uplot@1.6.32", "pkg:npm/plotly.js-gl3d-dist-min@4.1.1"):
        assert there[purl]["licenses"][0]["license"]["id"] == "MIT"
        assert there[purl]["hashes"]
