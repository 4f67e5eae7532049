"""Clients in Go, Rust and Java count every sample of a rig's fleet, as the speed page has them."""

import sys

import pytest

from benchmarks import foreign_clients
from benchmarks.foreign_clients import BUILD_S, CLIENTS, ForeignClient, Missing, built, counted
from support.building import building

VALVES, HZ, SECONDS = 5, 20.0, 3.0
LONGEST_S = BUILD_S + 300.0  # built once, and a rig started


@pytest.fixture
def soon_built(monkeypatch):
    """Rust's programs are built without optimization, apart from those whose speed is measured."""
    monkeypatch.setattr(foreign_clients, "BUILT", foreign_clients.BUILT / "plain")
    monkeypatch.setenv("CARGO_PROFILE_RELEASE_OPT_LEVEL", "0")


@pytest.mark.languages
@pytest.mark.timeout(LONGEST_S)
@pytest.mark.parametrize("name", CLIENTS)
def test_a_client_of_another_language_loses_nothing_of_a_fleet(name, soon_built):
    try:
        with building(foreign_clients.BUILT):
            built(name)
    except Missing as why:
        pytest.skip(f"{name}: {why}")
    figures = counted(name, VALVES, HZ, SECONDS)
    assert figures["lost"] == 0
    wanted = VALVES * HZ * foreign_clients.LOST_BY_SAMPLE
    assert 0.5 * wanted < figures["notifications/s"] < 2.0 * wanted  # a busy machine is late
    assert 0.0 <= figures["cores"] < 2.0


def test_a_client_that_cannot_be_built_says_why(monkeypatch):
    monkeypatch.setitem(CLIENTS, "absent", ForeignClient("gopcua", ("no-such-tool",), (), ("", "")))
    with pytest.raises(Missing, match="no-such-tool not installed"):
        built("absent")


def test_a_build_that_fails_says_what_was_said(monkeypatch, tmp_path):
    monkeypatch.setattr(foreign_clients, "BUILT", tmp_path)
    wrong = ForeignClient(
        "gopcua", (sys.executable, "-c", "raise SystemExit('no luck')"), (), ("", "")
    )
    monkeypatch.setitem(CLIENTS, "wrong", wrong)
    with pytest.raises(Missing, match="no luck"):
        built("wrong")
    assert not list(tmp_path.glob("*/ready"))


def test_what_is_built_once_is_not_built_again(monkeypatch, tmp_path):
    monkeypatch.setattr(foreign_clients, "BUILT", tmp_path)
    build = (sys.executable, "-c", "open('counter', 'a').write('x')")
    monkeypatch.setitem(CLIENTS, "made", ForeignClient("gopcua", build, (), ("", "")))
    assert built("made") == built("made")
    assert (built("made") / "counter").read_text() == "x"


def test_the_versions_of_all_stacks_are_pinned():
    assert foreign_clients.versions().keys() == CLIENTS.keys()
