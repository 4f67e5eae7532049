"""Services as people start them, each with its rig: a demo, and what ``valvemap init`` makes."""

import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from support.processes import free_port, rig_url, run, running, service_url, wait_for

_TURNED_AWAY_S = 90.0
PASSWORD = "a long enough password"


@dataclass(frozen=True)
class Service:
    """A service that runs; ``env`` is the environment of its commands."""

    url: str
    rig: str
    password: str
    log: Path
    env: dict[str, str] = field(default_factory=dict)

    @property
    def data(self):
        """The folder that ``valvemap init`` made."""
        return Path(self.env["VALVEMAP_DATA"])


@contextmanager
def demo(folder):
    """``valvemap demo``: security None on loopback, anybody may look."""
    log = folder / "demo.log"
    rig, service = rig_url(free_port()), service_url(free_port())
    env = {"VALVEMAP_SOURCE__URL": rig, "VALVEMAP_SERVER__URL": service}
    with running("demo", env=env, log=log) as process:
        password = wait_for(log, "password", process).split()[-1]
        wait_for(log, "samples; RMSE", process)
        yield Service(service, rig, password, log)


@contextmanager
def installation(folder):
    """``valvemap init``, ``rig`` and ``serve``: signed and encrypted, users only."""
    data = folder / "data"
    env = {"VALVEMAP_OPERATOR_PASSWORD": PASSWORD, "VALVEMAP_DATA": str(data)}
    made = run("init", env=env)
    assert made.returncode == 0, made.stderr
    assert PASSWORD not in made.stdout
    rig, service = rig_url(free_port()), service_url(free_port())
    env |= {"VALVEMAP_RIG_URL": rig, "VALVEMAP_SOURCE__URL": rig, "VALVEMAP_SERVER__URL": service}
    rig_log, log = folder / "rig.log", folder / "service.log"
    with running("rig", "--scenario", "demo", env=env, log=rig_log) as rig_process:
        wait_for(rig_log, rig, rig_process)
        serve = ["serve", "--config", str(data / "service.toml")]
        with running(*serve, env=env, log=log) as process:
            wait_for(log, "source connected", process)
            yield Service(service, rig, PASSWORD, log, env)
        assert process.returncode == 0
    assert PASSWORD not in log.read_text(encoding="utf-8")


def until_rejected(service):
    """The thumbprints of those whom a service turned away, as soon as there is one."""
    end = time.monotonic() + _TURNED_AWAY_S
    while not (lines := run("trust", env=service.env).stdout.splitlines()):
        assert time.monotonic() < end, "nobody was turned away"
    return [line.split()[0] for line in lines]
