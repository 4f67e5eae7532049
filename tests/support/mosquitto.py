"""A real Mosquitto, and a host of Sparkplug of another make that listens there."""

import json
import shutil
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from support import maven_peer
from support.node_peer import installed
from support.processes import free_port, is_open, program

PEER = Path(__file__).parents[1] / "sparkplug" / "peer"
TAHU = PEER.with_name("tahu_host")
_PLACES = "/usr/sbin:/usr/local/sbin:/usr/bin:/usr/local/bin"
_SOON_S = 120.0
GROUP, NODE, HOST = "Press shop", "valvemap", "SCADA"


class Mosquitto:
    """A broker on a port of its own; what is in ``more`` goes into its configuration."""

    def __init__(self, folder, more="allow_anonymous true"):
        self._program = shutil.which("mosquitto", path=_PLACES)
        if self._program is None:
            pytest.skip("mosquitto is not installed")
        self.port, self._process = free_port(), None
        self._file, self._log = folder / "mosquitto.conf", folder / "mosquitto.log"
        self._file.write_text(f"user root\nlistener {self.port} 127.0.0.1\n{more}\n")

    @property
    def url(self):
        return f"mqtt://127.0.0.1:{self.port}"

    def start(self):
        with self._log.open("ab") as out:
            command = [self._program, "-c", self._file]
            self._process = subprocess.Popen(command, stdout=out, stderr=out)
        until(lambda: is_open(self.port))

    def kill(self):
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None


@contextmanager
def mosquitto(folder, more="allow_anonymous true"):
    broker = Mosquitto(folder, more)
    broker.start()
    try:
        yield broker
    finally:
        broker.kill()


def users(folder, **passwords):
    """A file of users for Mosquitto, and what its configuration says of it."""
    tool, file = shutil.which("mosquitto_passwd", path=_PLACES), folder / "users"
    if tool is None:
        pytest.skip("mosquitto_passwd is not installed")
    file.touch()
    for user, password in passwords.items():
        subprocess.run([tool, "-b", file, user, password], check=True, capture_output=True)
    return f"allow_anonymous false\npassword_file {file}"


class Host:
    """What a host heard, message by message; its other lines are a log."""

    def __init__(self, process, log):
        self._process, self._log = process, log

    def heard(self):
        text = self._log.read_text(encoding="utf-8")
        lines = text.splitlines(keepends=True)
        return [json.loads(line) for line in lines if line[0] == "{" and line.endswith("\n")]

    def ask_for_births(self):
        self._process.stdin.write(b"births\n")
        self._process.stdin.flush()

    def command(self, device, path, value):
        line = json.dumps({"device": device, "path": path, "value": value})
        self._process.stdin.write(f"{line}\n".encode())
        self._process.stdin.flush()

    def complaints(self):
        """Warnings and errors of Tahu."""
        lines = self._log.read_text(encoding="utf-8").splitlines()
        return [line for line in lines if line.startswith(("WARN ", "ERROR "))]

    def once(self, condition, seconds=_SOON_S):
        """Wait until what was heard is as wanted; return it."""
        return until(lambda: (heard := self.heard()) and condition(heard) and heard, seconds)


@contextmanager
def host(folder, cache, broker):
    """A host that listens from before anybody says anything."""
    packages = installed(PEER, cache)
    script = shutil.copy(PEER / "host.cjs", packages)
    log = folder / "host.log"
    command = (shutil.which("node"), script, broker.url, GROUP, NODE, HOST)
    with program(*command, log=log) as process:
        listening = Host(process, log)
        listening.once(lambda heard: heard[0]["verb"] == "CONNECTED")
        yield listening


@contextmanager
def tahu_host(folder, cache, broker, user, password):
    """The host of Eclipse Tahu, listening from before anybody says anything."""
    command = maven_peer.program(TAHU, "valvemap.Host", cache)
    log, given = folder / "tahu.log", (GROUP, NODE, HOST, user, password)
    with program(*command, broker.url.replace("mqtt:", "tcp:"), *given, log=log) as process:
        listening = Host(process, log)
        listening.once(lambda heard: heard[0]["verb"] == "CONNECTED")
        yield listening


def until(condition, seconds=_SOON_S):
    """Wait until a condition holds; return what it says."""
    end = time.monotonic() + seconds
    while not (answer := condition()):
        assert time.monotonic() < end, f"not within {seconds:g} s"
        time.sleep(0.05)
    return answer
