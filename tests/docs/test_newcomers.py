"""Three ways to a newcomer's own server, each by the commands as README and documents write them.

With make and with pip in a copy of the tree in which nobody has worked (without ``make test``, that
runs elsewhere); with compose by a stand-in for ``docker`` that starts processes. Only what a
person fills in differs: address, password, thumbprint.
"""

import json
import os
import re
import ssl
import subprocess
import sys
import urllib.request
from contextlib import contextmanager
from pathlib import Path

import pytest

from guarded_opcua import Pki, ensure_certificate
from support.foreign import PLANT, Foreign, Guard
from support.processes import free_port, rig_url, service_url, wait_for
from support.typed import Block, Terminal

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
CONTAINERS = re.search(
    r"## As containers\n(.*?)\n## ",
    (ROOT / "docs" / "own_server.md").read_text(encoding="utf-8"),
    re.DOTALL,
)[1]
PLC = "opc.tcp://plc:4840"
INSTALLED_S = 1500.0  # what is there is downloaded and, at the first start, compiled
PASSWORD = "own password 7"

pytestmark = [
    pytest.mark.tutorial,
    pytest.mark.timeout(3600),
    pytest.mark.skipif(os.name != "posix", reason="the commands are typed into a POSIX shell"),
]


def readme(heading):
    """The commands of each block of a section of README."""
    section = re.search(rf"^## {heading}\n(.*?)^## ", README, re.MULTILINE | re.DOTALL)[1]
    return re.findall(r"^```\n(.*?)^```$", section, re.MULTILINE | re.DOTALL)


def containers():
    """The commands of each block about containers."""
    return re.findall(r"^```sh\n(.*?)^```$", CONTAINERS, re.MULTILINE | re.DOTALL)


@contextmanager
def plc(guard=None):
    """A server of another make with one valve."""
    server = Foreign(PLANT, ["Ventil 7"], guard=guard)
    server.start()
    assert server.ready.wait(180)
    try:
        yield server.url
    finally:
        server.over.set()
        server.join(30)


def addresses():
    """Variables that put rig and service elsewhere: other tests may take their usual ports."""
    return {
        "VALVEMAP_SOURCE__URL": rig_url(free_port()),
        "VALVEMAP_SERVER__URL": service_url(free_port()),
    }


def check_out(folder):
    """A copy of what is tracked."""
    tracked = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    archive = ["tar", "--create", "--null", "--files-from=-"]
    packed = subprocess.run(
        archive, cwd=ROOT, input=tracked.encode(), capture_output=True, check=True
    )
    subprocess.run(["tar", "--extract"], cwd=folder, input=packed.stdout, check=True)


@pytest.mark.image
@pytest.mark.parametrize("block", [0, 1], ids=["make", "pip"])
def test_a_copy_of_the_tree_is_installed_shows_the_demo_and_serves_an_own_server(block, tmp_path):
    check_out(tmp_path)
    commands = readme("See it work")[block].replace("make test ", ": make test ")
    terminal = Terminal(tmp_path, tmp_path / "terminal.log", addresses())
    try:
        terminal.type(Block("1", commands, ("page …", "Valvistor: …")), INSTALLED_S)
        terminal.interrupt()
        (own,) = readme("On your own server")
        with plc() as url:
            own = own.replace(PLC, url)
            shown = (
                "user operator, password …",
                "written: plant.toml; …",
                "…first results published…",
            )
            terminal.type(Block("1", f"unset VALVEMAP_SOURCE__URL\n{own}", shown), INSTALLED_S)
            terminal.interrupt()
    finally:
        terminal.close()
    assert "Traceback" not in terminal.text()


@pytest.fixture
def docker(tmp_path):
    """A terminal in the folder of valvemap, with a stand-in for docker; the port of the page."""
    for name in ("bin", "data", "log"):
        (tmp_path / name).mkdir()
    here = os.pathsep.join(str(ROOT / part) for part in ("service", "virtual_rig", "tests"))
    program = tmp_path / "bin" / "docker"
    program.write_text(
        f'#!/bin/sh\nPYTHONPATH={here} exec "{sys.executable}" -m support.compose_stand_in "$@"\n'
    )
    program.chmod(0o755)
    path = [tmp_path / "bin", Path(sys.executable).parent, os.environ["PATH"]]
    port = str(free_port())
    terminal = Terminal(
        tmp_path,
        tmp_path / "log" / "terminal.log",
        {
            "PATH": os.pathsep.join(map(str, path)),
            "STAND_IN_DATA": str(tmp_path / "data"),
            "VALVEMAP_RIG_PORT": str(free_port()),
            "VALVEMAP_SERVICE_PORT": str(free_port()),
            "VALVEMAP_PAGE_PORT": port,
        },
    )
    yield terminal, port
    terminal.close()


def test_containers_serve_an_own_server_that_asks_for_certificate_and_user(docker, tmp_path):
    terminal, port = docker
    trusted = tmp_path / "trusted"
    trusted.mkdir()
    own = ensure_certificate(Pki(tmp_path / "plc"), "urn:plc:server", ("127.0.0.1",), "plc")
    guard = Guard(own.certificate, own.key, "urn:plc:server", trusted, "service", PASSWORD)
    first, second, https = containers()
    terminal.type(Block("1", first, ("user operator, password …",)))
    terminal.type(Block("1", "wait"))
    password = re.search(r"user operator, password (\S+)", terminal.text())[1]
    (tmp_path / "valvemap-service.der").rename(trusted / "valvemap-service.der")
    with plc(guard) as url:
        commands = second.replace(PLC, url).replace("PASSWORD=…", f"PASSWORD='{PASSWORD}'")
        until_trust, trust_and_up = re.split(r"^(?=.* init trust )", commands, flags=re.MULTILINE)
        shown = ("…trust…",)
        said = terminal.type(Block("1", until_trust, shown))
        thumbprint = re.search(r"\b[0-9a-fA-F]{40,64}\b", said)[0]
        up = trust_and_up.replace("THUMBPRINT", thumbprint)
        terminal.type(Block("1", up, ("…results served…",)))
        page = f"http://localhost:{port}"
        wait_for(tmp_path / "log" / "terminal.log", "first results published")
        assert 'valvemap_samples_total{valve="Ventil_7"}' in fetched(f"{page}/metrics")
        terminal.interrupt()
        terminal.type(
            Block("1", https.replace(":8080", f":{port}"), ("…first results published…",))
        )
        check_log_in(tmp_path / "page.crt", f"https://localhost:{port}", password)
        terminal.interrupt()
    assert "Traceback" not in terminal.text()


def fetched(url):
    with urllib.request.urlopen(url, timeout=30) as answer:  # noqa: S310 - our own page
        return answer.read().decode()


def check_log_in(certificate, url, password):
    body = json.dumps({"user": "operator", "password": password}).encode()
    head = {"Content-Type": "application/json", "Origin": url}
    asked = urllib.request.Request(f"{url}/log-in", body, head)  # noqa: S310 - our own page
    trusted = ssl.create_default_context(cafile=certificate)
    with urllib.request.urlopen(asked, timeout=60, context=trusted) as answer:  # noqa: S310
        assert json.load(answer) == {"user": "operator"}
