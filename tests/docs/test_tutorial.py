"""A new user with the tutorial alone: every block is run as it stands, and says what it says."""

import os
import re
import signal
import subprocess
import sys
import time
import urllib.request
from dataclasses import dataclass
from pathlib import Path

import pytest

from support.processes import free_port, is_open

ROOT = Path(__file__).parents[2]
TUTORIAL = ROOT / "docs" / "tutorial.md"
_BLOCK = re.compile(r'^```(sh title="terminal (\d)"|text)\n(.*?)^```$', re.MULTILINE | re.DOTALL)
_DEFAULT_PORTS = (4840, 4841, 8080)
_LONGEST_S = 420.0  # of one block: a first run compiles, perhaps beside others


@dataclass(frozen=True)
class Block:
    """Commands for a terminal, and what it shows then."""

    terminal: str
    commands: str
    shown: tuple[str, ...]


def blocks():
    """The tutorial's blocks, in order."""
    found = []
    for kind, terminal, body in _BLOCK.findall(TUTORIAL.read_text(encoding="utf-8")):
        if kind == "text":
            found[-1] = Block(found[-1].terminal, found[-1].commands, tuple(body.splitlines()))
        else:
            found.append(Block(terminal, body, ()))
    return found


class Terminal:
    """A shell that is typed into."""

    def __init__(self, folder, log):
        self._log, self._read = log, 0
        env = {
            k: v for k, v in os.environ.items() if not k.startswith(("MAKE", "MFLAGS", "VIRTUAL"))
        }
        with log.open("wb") as out:
            self._shell = subprocess.Popen(
                ["sh"],
                stdin=subprocess.PIPE,
                stdout=out,
                stderr=subprocess.STDOUT,
                cwd=folder,
                env={**env, "COLUMNS": "160", "PYTHONUNBUFFERED": "1"},
                start_new_session=True,
            )

    def type(self, block):
        """Type a block in, and wait until it shows what it should, or is done."""
        self._read = len(self.text())
        done = f"done-{time.monotonic_ns()}"
        self._shell.stdin.write(f"{block.commands}\necho {done} $?\n".encode())
        self._shell.stdin.flush()
        wanted = [_pattern(line) for line in block.shown if line != "…"] or [
            re.compile(f"{done} 0")
        ]
        end = time.monotonic() + _LONGEST_S
        while not _in_order(wanted, self.new()) and done not in self.new():
            assert time.monotonic() < end, f"{block.commands}\n{self.new()}"
            time.sleep(0.1)
        assert _in_order(wanted, self.new()), f"{block.commands}\n{self.new()}"
        for line in self.new().splitlines():
            assert not line.startswith(("valvemap:", "sh:", "make: ***")), self.new()

    def text(self):
        return self._log.read_text(encoding="utf-8", errors="replace")

    def new(self):
        return self.text()[self._read :]

    def close(self):
        for kill in (signal.SIGINT, signal.SIGKILL):
            try:
                os.killpg(self._shell.pid, kill)
                self._shell.wait(20)
            except (ProcessLookupError, subprocess.TimeoutExpired):
                continue
        self._shell.stdin.close()


def _pattern(line):
    return re.compile(".*".join(map(re.escape, re.split("…", line))))


def _in_order(patterns, text):
    lines = iter(text.splitlines())
    return all(any(pattern.fullmatch(line.strip()) for line in lines) for pattern in patterns)


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
