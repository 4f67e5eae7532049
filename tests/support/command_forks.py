"""``valvemap`` commands in forks of a process that has imported their modules, which takes 2 s.

A fork has its own arguments, environment, folder, standard files, signals and exit code, and ends
as Python ends. It is no start of Python: what judges a start runs `subprocess`.
"""

import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from functools import cache
from pathlib import Path

READ_AT_START = ("PYTHON", "NUMBA_", "OPENBLAS_", "OMP_", "LD_", "LC_", "LANG")
"""Beginnings of names of variables that Python and its libraries read when they are started."""

_SERVER = Path(__file__).with_name("command_server.py")
_ADDRESS = f"\0valvemap-commands-{os.environ.get('PYTEST_XDIST_TESTRUNUID', os.getpid())}"
_ENVIRONMENT, _FOLDER = dict(os.environ), Path.cwd()  # before any test changes them


class Fork:
    """A running command, with what `subprocess.Popen` has for it."""

    spent_s = 0.0
    """Processor time of all that have ended."""

    def __init__(self, arguments, said):
        self.args, self._said = arguments, said
        self.returncode = None
        self.pid = int(self._line())

    def poll(self):
        return self._look(0)

    def wait(self, timeout=None):
        if self._look(None if timeout is None else 1e3 * timeout) is None:
            raise subprocess.TimeoutExpired(self.args, timeout)
        return self.returncode

    def send_signal(self, number):
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self):
        self.send_signal(signal.SIGKILL)

    def _look(self, longest_ms):
        if self.returncode is None:
            ended = select.poll()
            ended.register(self._said, select.POLLIN)
            if ended.poll(longest_ms):
                self.returncode, seconds = json.loads(self._line())
                Fork.spent_s += seconds
                self._said.close()
        return self.returncode

    def _line(self):
        line = self._said.readline()
        assert line, "the process that forks has ended"
        return line


class CommandServer:
    """A connection to the process that forks, which the workers of a run share.

    The first worker starts it; it ends when the last connection does.
    """

    def __init__(self):
        self._orders = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with suppress(OSError):  # another worker has started it
            self._process = _start()
        _connect(self._orders)
        assert self._orders.recv(1), "the process that forks has ended"

    def start(self, arguments, environment, folder, standard):
        """Run ``valvemap`` in a fork with these descriptors for its three standard files."""
        order = {
            "arguments": arguments,
            "environment": environment,
            "folder": str(folder or Path.cwd()),
        }
        here, there = os.pipe()
        try:
            socket.send_fds(self._orders, [json.dumps(order).encode()], [there, *standard])
        finally:
            os.close(there)
        return Fork(arguments, os.fdopen(here, "rb", buffering=0))


command_server = cache(CommandServer)


def _connect(orders):
    """Connect, also between the moments at which another worker binds the address and listens."""
    last = time.monotonic() + 5.0
    while True:
        try:
            return orders.connect(_ADDRESS)
        except ConnectionRefusedError:
            if time.monotonic() > last:
                raise
            time.sleep(0.01)


def _start():
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as door:
        door.bind(_ADDRESS)
        door.listen()
        return subprocess.Popen(
            [sys.executable, "-P", "-u", _SERVER, str(door.fileno())],
            stdin=subprocess.DEVNULL,
            pass_fds=[door.fileno()],
            cwd=_FOLDER,
            env=_ENVIRONMENT,
        )


def can_fork(environment):
    """Whether a fork can stand for a start of Python in this environment."""
    return hasattr(os, "pidfd_open") and _at_start(environment) == _at_start(_ENVIRONMENT)


def _at_start(environment):
    return {name: value for name, value in environment.items() if name.startswith(READ_AT_START)}
