"""A new user with the tutorial alone: every block is run as it stands, and says what it says."""

import os
import re
import sys
import urllib.request
from pathlib import Path

import pytest

from support.processes import free_port, is_open
from support.typed import Block, Terminal

ROOT = Path(__file__).parents[2]
TUTORIAL = ROOT / "docs" / "tutorial.md"
_BLOCK = re.compile(r'^```(sh title="terminal (\d)"|text)\n(.*?)^```$', re.MULTILINE | re.DOTALL)
_DEFAULT_PORTS = (4840, 4841, 8080)


def blocks():
    """The tutorial's blocks, in order."""
    found = []
    for kind, terminal, body in _BLOCK.findall(TUTORIAL.read_text(encoding="utf-8")):
        if kind == "text":
            found[-1] = Block(found[-1].terminal, found[-1].commands, tuple(body.splitlines()))
        else:
            found.append(Block(terminal, body, ()))
    return found


def _moved(text, ports):
    for port, free in ports.items():
        text = re.sub(rf"\b{port}\b", str(free), text)
    return text


def _check_out(folder):
    """A folder of valvemap in which nobody has worked yet, installed from the lock file by now."""
    for entry in ROOT.iterdir():
        if entry.name != ".venv":
            (folder / entry.name).symlink_to(entry)
    installed = folder / ".venv"
    installed.mkdir()
    for entry in Path(sys.prefix).iterdir():
        if entry.name != ".runtime":
            (installed / entry.name).symlink_to(entry)
    (installed / ".runtime").touch()


@pytest.mark.tutorial
@pytest.mark.timeout(1200)
@pytest.mark.skipif(os.name != "posix", reason="the tutorial is typed into a POSIX shell")
def test_every_block_of_the_tutorial_does_what_it_says(tmp_path, monkeypatch):
    ports = {port: free_port() for port in _DEFAULT_PORTS if is_open(port)}  # else as it stands
    monkeypatch.setenv("VALVEMAP_RIG_URL", _moved("opc.tcp://127.0.0.1:4840/valvemap/rig/", ports))
    service = _moved("opc.tcp://127.0.0.1:4841/valvemap/service/", ports)
    monkeypatch.setenv("VALVEMAP_SERVER__URL", service)
    monkeypatch.setenv("VALVEMAP_SERVICE_URL", service)
    monkeypatch.setenv("VALVEMAP_PAGE_LISTEN", _moved("127.0.0.1:8080", ports))
    _check_out(tmp_path)
    terminals = {}
    try:
        for block in blocks():
            if block.terminal not in terminals:
                log = tmp_path / f"terminal {block.terminal}.log"
                terminals[block.terminal] = Terminal(tmp_path, log)
            shown = tuple(_moved(line, ports) for line in block.shown)
            moved = Block(block.terminal, _moved(block.commands, ports), shown)
            terminals[block.terminal].type(moved)
        page = _moved("http://127.0.0.1:8080/metrics", ports)
        with urllib.request.urlopen(page, timeout=10) as answer:  # noqa: S310 - our own page
            assert 'valvemap_samples_total{valve="Valvistor"}' in answer.read().decode()
    finally:
        for terminal in terminals.values():
            terminal.close()
    plant = tmp_path / "plant"
    assert "FB_ValveRequiredU" in (plant / "valve.st").read_text(encoding="utf-8")
    assert (plant / "pictures" / "index.html").exists()


def test_the_tutorial_goes_from_connect_to_export():
    commands = "".join(block.commands for block in blocks())
    places = [commands.index(f"valvemap {c}") for c in ("connect", "serve", "dashboard", "export")]
    assert places == sorted(places)
