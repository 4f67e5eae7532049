"""Running the real command in processes of their own, and leaving none behind."""

import itertools
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile

from support.command_forks import can_fork, command_server

READY_S = 120.0


# Below those that systems hand out to whoever connects: one of these would be taken between the
# look and the start of the server that is meant. Processes begin far from each other.
_ports = itertools.cycle(12_000 + (os.getpid() * 997 + k) % 20_000 for k in range(20_000))


def free_port() -> int:
    """A port of 127.0.0.1 that nobody listens on, another one at each call."""
    for port in _ports:
        with socket.socket() as probe, suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port
    raise AssertionError("no port is free")


def rig_url(port: int) -> str:
    return f"opc.tcp://127.0.0.1:{port}/valvemap/rig/"


def service_url(port: int) -> str:
    return f"opc.tcp://127.0.0.1:{port}/valvemap/service/"


def run(*arguments: str, env: dict[str, str] | None = None, timeout: float = READY_S):
    """Run ``valvemap`` to its end; the answer has returncode, stdout and stderr."""
    with TemporaryFile("w+", encoding="utf-8") as out, TemporaryFile("w+", encoding="utf-8") as err:
        process = _started(arguments, env, None, (0, out.fileno(), err.fileno()))
        try:
            process.wait(timeout)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            raise
        out.seek(0)
        err.seek(0)
        return subprocess.CompletedProcess(arguments, process.returncode, out.read(), err.read())


@contextmanager
def running(
    *arguments: str,
    env: dict[str, str] | None = None,
    stdin: str = "",
    log: Path,
    cwd: Path | None = None,
):
    """Run ``valvemap`` in the background, its output in ``log``; interrupted at the end."""
    theirs, ours = os.pipe()
    with os.fdopen(ours, "wb") as end_of_stdin, log.open("wb") as out:
        try:
            process = _started(arguments, env, cwd, (theirs, out.fileno(), out.fileno()))
        finally:
            os.close(theirs)
        with _interrupted(process, stdin, end_of_stdin):
            yield process


@contextmanager
def program(
    *command: str | Path,
    env: dict[str, str] | None = None,
    stdin: str = "",
    log: Path,
    cwd: Path | None = None,
):
    """Run a program in the background, its output in ``log``; interrupted at the end."""
    with log.open("wb") as out:
        process = subprocess.Popen(
            command,
            cwd=cwd,
            stdin=subprocess.PIPE,
            stdout=out,
            stderr=subprocess.STDOUT,
            env={**os.environ, **(env or {})},
        )
        with process.stdin, _interrupted(process, stdin, process.stdin):
            yield process


@contextmanager
def _interrupted(process, stdin, end_of_stdin):
    try:
        end_of_stdin.write(stdin.encode())
        end_of_stdin.flush()
        yield
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _started(arguments, env, cwd, standard):
    """``valvemap`` in a fork, or in a new Python where that may behave otherwise."""
    environment = {**os.environ, **(env or {})}
    if can_fork(environment):
        return command_server().start(arguments, environment, cwd, standard)
    stdin, stdout, stderr = standard
    return subprocess.Popen(
        [sys.executable, "-u", "-m", "valvemap", *arguments],
        cwd=cwd,
        stdin=stdin,
        stdout=stdout,
        stderr=stderr,
        env=environment,
    )


def wait_for(log: Path, text: str, process=None, timeout: float = READY_S) -> str:
    """Wait until ``text`` stands in ``log``; return the line that holds it."""
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        for line in log.read_text(encoding="utf-8", errors="replace").splitlines():
            if text in line:
                return line
        if process is not None and process.poll() is not None:
            break
        time.sleep(0.05)
    raise AssertionError(f"{text!r} never came; the log holds:\n{log.read_text()}")


def is_open(port: int) -> bool:
    """Whether somebody listens on the port."""
    with socket.socket() as probe:
        probe.settimeout(1.0)
        return probe.connect_ex(("127.0.0.1", port)) == 0
