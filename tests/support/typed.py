"""Commands of a document, typed into shells as they stand there."""

import contextlib
import os
import re
import signal
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

LONGEST_S = 100.0  # of one block: a first run compiles, perhaps beside others


@dataclass(frozen=True)
class Block:
    """Commands for a terminal, and the lines that it shows then; ``…`` stands for any text."""

    terminal: str
    commands: str
    shown: tuple[str, ...] = ()


class Terminal:
    """A shell that is typed into; its output is kept in a file.

    Parameters
    ----------
    folder
        Where it starts.
    log
        Where its output goes.
    env
        Variables beside those of this process.
    """

    def __init__(self, folder, log, env=None):
        self._log, self._read = log, 0
        own = {
            k: v
            for k, v in os.environ.items()
            if not k.startswith(("MAKE", "MFLAGS", "VIRTUAL", "PYTHONPATH"))
        }
        with log.open("wb") as out:
            self._shell = subprocess.Popen(
                ["sh"],
                stdin=subprocess.PIPE,
                stdout=out,
                stderr=subprocess.STDOUT,
                cwd=folder,
                env={**own, "COLUMNS": "160", "PYTHONUNBUFFERED": "1", **(env or {})},
                start_new_session=True,
            )

    def type(self, block, longest_s=LONGEST_S):
        """Type a block in, and wait until it shows what it should, or is done; return that."""
        self._read = len(self.text())
        done = f"done-{time.monotonic_ns()}"
        self._shell.stdin.write(f"{block.commands}\necho {done} $?\n".encode())
        self._shell.stdin.flush()
        wanted = [_pattern(line) for line in block.shown if line != "…"] or [
            re.compile(f"{done} 0")
        ]
        end = time.monotonic() + longest_s
        while not _in_order(wanted, self.new()) and done not in self.new():
            assert time.monotonic() < end, f"{block.commands}\n{self.new()}"
            time.sleep(0.1)
        assert _in_order(wanted, self.new()), f"{block.commands}\n{self.new()}"
        for line in self.new().splitlines():
            is_meant = any(pattern.fullmatch(line.strip()) for pattern in wanted)
            assert is_meant or not line.startswith(("valvemap:", "sh:", "make: ***")), self.new()
        return self.new()

    def interrupt(self):
        """Press Ctrl-C: everything that the shell runs is interrupted, and has ended."""
        begun = _below(self._shell.pid)
        for process in begun:
            _signal(process, signal.SIGINT)
        end = time.monotonic() + LONGEST_S
        while any(Path(f"/proc/{process}").exists() for process in begun):
            assert time.monotonic() < end, self.new()
            time.sleep(0.1)

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


def _below(process):
    """Return what a process has started, and what that has."""
    found = []
    for children in Path(f"/proc/{process}/task").glob("*/children"):
        for child in map(int, children.read_text().split()):
            found += [child, *_below(child)]
    return found


def _signal(process, kind):
    with contextlib.suppress(ProcessLookupError):
        os.kill(process, kind)


def _pattern(line):
    return re.compile(".*".join(map(re.escape, re.split("…", line))))


def _in_order(patterns, text):
    lines = iter(text.splitlines())
    return all(any(pattern.fullmatch(line.strip()) for line in lines) for pattern in patterns)
