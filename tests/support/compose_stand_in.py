"""Stands for ``docker`` where there is none: ``docker compose`` of our file, by processes.

A container's folder /data is `STAND_IN_DATA`; its names and ports are those that are published on
localhost. What isolates containers is left out: ``test_containers_run.py`` has that, by podman.
"""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time

import yaml

from support.compose import ROOT, interpolated

_HEALTHY_S = 300.0
_OUTSIDE = dict(os.environ)


def main(words):
    """Do what ``docker WORDS`` does; return its exit code."""
    match words:
        case ["compose", "build"]:
            return 0 if (ROOT / "Dockerfile").exists() else 1
        case ["compose", "run", "--rm", *more]:
            return Project().run(more)
        case ["compose", "up"]:
            return Project().up()
    sys.stderr.write(f"not understood here: docker {' '.join(words)}\n")
    return 2


class Project:
    """The services of the file that belong to no profile."""

    def __init__(self):
        said = yaml.safe_load((ROOT / "docker-compose.yml").read_text(encoding="utf-8"))
        self.services = {k: s for k, s in said["services"].items() if "profiles" not in s}
        self.running = {}
        published = [interpolated(p, _OUTSIDE) for p in self._ports()]
        self.ports = {p.split(":")[2]: p.split(":")[1] for p in published}

    def _ports(self):
        return [port for said in self.services.values() for port in said.get("ports", ())]

    def run(self, words):
        """``run --rm``, after what the service depends on has completed."""
        entrypoint = None
        while words[0].startswith("-"):
            option, *words = words
            if option == "--entrypoint":
                entrypoint, *words = words
            elif option != "-T":
                sys.stderr.write(f"unknown flag: {option}\n")
                return 2
        name, *words = words
        for other in self.services[name].get("depends_on", {}):
            if code := self._started(other).wait():
                return code
        return self._started(name, words, entrypoint).wait()

    def up(self):
        """Each service as soon as those that it depends on are as far; all until Ctrl-C."""
        over = threading.Event()
        signal.signal(signal.SIGINT, lambda *_: over.set())
        try:
            for name in self._in_order():
                for other, kind in self.services[name].get("depends_on", {}).items():
                    if not self._is_as_far(other, kind["condition"], over):
                        sys.stderr.write(f"service {other!r} is not {kind['condition']}\n")
                        return 1
                self.running[name] = self._started(name)
            over.wait()
            return 130
        finally:
            for process in reversed(self.running.values()):
                with contextlib.suppress(ProcessLookupError):
                    process.send_signal(signal.SIGINT)
                process.wait()

    def _in_order(self):
        found = []
        while len(found) < len(self.services):
            ready = (
                name
                for name, said in self.services.items()
                if name not in found and set(said.get("depends_on", {})) <= set(found)
            )
            found.append(next(ready))
        return found

    def _is_as_far(self, name, condition, over):
        process = self.running[name]
        if condition == "service_completed_successfully":
            return process.wait() == 0
        end = time.monotonic() + _HEALTHY_S
        while time.monotonic() < end and process.poll() is None and not over.is_set():
            words = self.services[name]["healthcheck"]["test"][1:]
            if self._process(name, words, stderr=subprocess.DEVNULL).wait() == 0:
                return True
            time.sleep(0.5)
        return False

    def _started(self, name, words=(), entrypoint=None):
        said = self.services[name]
        program = [entrypoint] if entrypoint else said.get("entrypoint", ["valvemap"])
        return self._process(name, [*program, *(words or said["command"])])

    def _process(self, name, words, **more):
        said, env = self.services[name], dict(_OUTSIDE)
        for variable, value in said.get("environment", {}).items():
            if value is not None:
                env[variable] = self._here(interpolated(value, _OUTSIDE))
        here = [self._here(interpolated(word, _OUTSIDE)) for word in words]
        ports = {"4840", "4841"} & set(here)  # of a check of health
        here = [self.ports[word] if word in ports else word for word in here]
        return subprocess.Popen(here, env=env, cwd=_OUTSIDE["STAND_IN_DATA"], **more)

    def _here(self, text):
        places = {
            "/own_source.sh": str(ROOT / "container" / "own_source.sh"),
            "/opt/valvemap/healthcheck.py": str(ROOT / "container" / "healthcheck.py"),
            "/data": _OUTSIDE["STAND_IN_DATA"],
        }
        for place, there in places.items():
            text = text.replace(place, there)
        for port, there in self.ports.items():
            text = text.replace(f"0.0.0.0:{port}", f"127.0.0.1:{there}")
            for host in self.services:
                text = text.replace(f"{host}:{port}", f"localhost:{there}")
            text = text.replace(f"127.0.0.1:{port}", f"127.0.0.1:{there}")
        return text


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
