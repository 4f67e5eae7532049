"""Containers of docker-compose.yml, run by podman: each with all that the file says of it.

Compose itself is not there: what it does is the order of the start, which a test gives.
"""

import json
import re
import shlex
import shutil
import subprocess
import time
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]
_LIMITS = "--ulimit=nofile=1024:1024", "--ulimit=nproc=4096:4096"  # lower than any machine's
_STANDS_FOR = re.compile(r"\$\{(\w+)(:[-+])([^}]*)\}")


def interpolated(text, outside):
    """Text as compose makes it: ``${A:-b}`` and ``${A:+b}``, where ``outside`` is set."""

    def chosen(found):
        name, operator, other = found.groups()
        value = outside.get(name, "")
        return (value or other) if operator == ":-" else (other if value else "")

    return _STANDS_FOR.sub(chosen, text)


def missing():
    """Why no container can be run here; empty if one can."""
    absent = [name for name in ("buildah", "podman", "runc") if shutil.which(name) is None]
    return f"{', '.join(absent)} not installed" if absent else ""


class Project:
    """Containers, network and volumes of one name; removed at its end.

    Parameters
    ----------
    name
        Prefix of all names.
    image
        The image of our containers.
    """

    def __init__(self, name, image):
        self._name, self._image, self._started = name, image, set()
        self.services = yaml.safe_load((ROOT / "docker-compose.yml").read_text())["services"]

    def __enter__(self):
        self._podman("network", "create", f"{self._name}_default")
        return self

    def __exit__(self, *_):
        for service in self._started:
            self._podman("rm", "--force", "--ignore", "--time", "5", f"{self._name}_{service}_1")
        self._podman("volume", "rm", "--force", f"{self._name}_data")
        self._podman("network", "rm", "--force", f"{self._name}_default")

    def run(self, service, *words, stdin=None, entrypoint=None, **outside):
        """``docker compose run --rm SERVICE WORDS``; return its result."""
        arguments = self._arguments(service, outside, words, entrypoint)
        return self._podman("run", "--rm", "--interactive", *arguments, stdin=stdin, check=False)

    def start(self, service, **outside):
        """What ``docker compose up`` does with one service that stays."""
        self.remove(service)
        self._started.add(service)
        name = f"{self._name}_{service}_1"
        self._podman("run", "--detach", "--name", name, *self._arguments(service, outside))

    def start_foreign(self, service, script, folder):
        """Start a container that is not ours: a Python program, with a folder that it imports."""
        self._started.add(service)
        self._podman(
            *("run", "--detach", "--name", f"{self._name}_{service}_1", *_LIMITS),
            *("--network", f"{self._name}_default", "--network-alias", service),
            *("--volume", f"{folder}:/foreign:ro", "--workdir", "/foreign"),
            *("--entrypoint", '["python", "-c"]', "--no-healthcheck", self._image, script),
        )

    def remove(self, service):
        """Stop and remove a container, as Ctrl-C and ``docker compose rm`` do; return its log."""
        name = f"{self._name}_{service}_1"
        self._podman("stop", "--ignore", name)
        return self._podman("rm", "--ignore", name).stdout

    def execute(self, service, *words):
        """``docker compose exec SERVICE WORDS``; return its result."""
        return self._podman("exec", f"{self._name}_{service}_1", *words, check=False)

    def log(self, service):
        """What a container has printed."""
        found = self._podman("logs", f"{self._name}_{service}_1", check=False)
        return found.stdout + found.stderr

    def wait_healthy(self, service, timeout=120.0, **outside):
        """Ask for its health as the file says, until it is good."""
        kind, *check = self.services[service]["healthcheck"]["test"]
        assert kind == "CMD"
        words, end = [interpolated(word, outside) for word in check], time.monotonic() + timeout
        while (found := self.execute(service, *words)).returncode:
            assert time.monotonic() < end, found.stderr + self.log(service)
            time.sleep(0.5)

    def _arguments(self, service, outside, words=(), entrypoint=None):
        """Return the options, image and words of a service for ``podman run``."""
        said = self.services[service]
        network = said.get("network_mode") or f"{self._name}_default"
        alias = [] if said.get("network_mode") else ["--network-alias", service]
        program = [entrypoint] if entrypoint else said.get("entrypoint", [])
        command = words or [interpolated(word, outside) for word in said["command"]]
        return [
            *("--user", said["user"], "--pids-limit", str(said["pids_limit"])),
            *(["--read-only", "--read-only-tmpfs=false"] if said["read_only"] else []),
            *(f"--cap-drop={one}" for one in said["cap_drop"]),
            *(f"--security-opt={one.removesuffix(':true')}" for one in said["security_opt"]),
            *(f"--tmpfs={one}" for one in said["tmpfs"]),
            *(f"--volume={self._volume(one)}" for one in said["volumes"]),
            *(f"--env={name}={value}" for name, value in self._environment(said, outside)),
            *(f"--publish={interpolated(one, outside)}" for one in said.get("ports", ())),
            *("--network", network, *alias, "--no-healthcheck", *_LIMITS),
            *([f"--entrypoint={json.dumps(program)}"] if program else []),
            *(self._image, *command),
        ]

    def _environment(self, said, outside):
        for name, value in said.get("environment", {}).items():
            if value is not None:
                yield name, interpolated(value, outside)
            elif name in outside:
                yield name, outside[name]

    def _volume(self, said):
        source, _, rest = said.partition(":")
        return f"{ROOT / source}:{rest}" if source.startswith(".") else f"{self._name}_{said}"

    def _podman(self, *words, stdin=None, check=True):
        done = subprocess.run(
            ["podman", "--runtime", "runc", *words],
            input=stdin,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        assert not check or done.returncode == 0, f"{shlex.join(words)}\n{done.stderr}"
        return done
