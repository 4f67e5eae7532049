"""FUXA without a screen: it is asked, and given its project, by its own web API."""

import json
import os
import shutil
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from support.building import building
from support.node_peer import installed
from support.node_red import PACKAGES, answers
from support.processes import free_port, program

ROOT = Path(__file__).parents[2]
PROJECT = ROOT / "docs" / "how-to" / "fuxa_project.json"
LOADER = ROOT / "container" / "scada" / "load_project.py"
_STARTS_S = 120.0
_ANSWERS_S = 90.0
_BUILDS_S = 400.0  # its SQLite, from source: a half minute on a machine that is idle


class Fuxa:
    """A FUXA that runs."""

    def __init__(self, http):
        self.http = http

    def load(self, service, *security):
        """Give it our project, as compose does."""
        where = ["--fuxa", str(self.http.base_url).rstrip("/"), "--service", service]
        subprocess.run([sys.executable, LOADER, PROJECT, *where, *security], check=True)

    def values(self):
        """The values that it has, by the name of the tag."""
        tags = project_tags()
        asked = {"ids": json.dumps(list(tags))}
        found = self.http.get("/api/getTagValue", params=asked).raise_for_status().json()
        return {tags[one["id"]]["name"]: one.get("value") for one in found}

    def write(self, name, value):
        """Set a tag, as an input field does."""
        (tag,) = (id_ for id_, tag in project_tags().items() if tag["name"] == name)
        body = {"tags": [{"id": tag, "value": value}]}
        self.http.post("/api/setTagValue", json=body).raise_for_status()

    def once(self, good):
        """Wait for values that are good to the caller."""
        end = time.monotonic() + _ANSWERS_S
        while not good(values := self.values()):
            assert time.monotonic() < end, values
            time.sleep(0.5)
        return values

    def alarms(self):
        """The alarms that stand, by name."""
        found = self.http.get("/api/alarms").raise_for_status().json()
        return {one["name"].partition("^")[0]: one for one in found}  # name, ^~^, priority


def project_tags():
    """The tags of our project, by id."""
    (device,) = json.loads(PROJECT.read_text(encoding="utf-8"))["devices"].values()
    return device["tags"]


@contextmanager
def fuxa(folder, cache):
    """FUXA with nothing in it; what it writes goes to the folder."""
    packages = installed(PACKAGES, cache)
    with building(cache):
        _build_sqlite(packages)
    port = free_port()
    script = packages / "node_modules" / "@frangoteam" / "fuxa" / "main.js"
    where = {"HOME": str(folder), "XDG_CONFIG_HOME": str(folder), "PORT": str(port)}
    command = (shutil.which("node"), script, "--userDir", folder)
    with (
        program(*command, env=where, cwd=folder, log=folder / "fuxa.log"),
        httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60.0) as http,
    ):
        answers(http, "/api/project", _STARTS_S)
        yield Fuxa(http)


def _build_sqlite(packages):
    """Build what npm would fetch from a host of its own; skip the test where there is no way."""
    built = packages / "node_modules" / "sqlite3" / "build" / "Release" / "node_sqlite3.node"
    if built.exists():
        return
    env = {"npm_config_build_from_source": "true"}
    prefix = Path(shutil.which("node")).resolve().parents[1]
    if (prefix / "include" / "node" / "node.h").exists():
        env["npm_config_nodedir"] = str(prefix)  # else node-gyp fetches the headers
    if Path("/usr/include/sqlite3.h").exists():
        env["npm_config_sqlite"] = "/usr"  # else the whole of SQLite is compiled
    try:
        done = subprocess.run(
            [shutil.which("npm"), "rebuild", "sqlite3", "--loglevel=error"],
            cwd=packages,
            env={**os.environ, **env},
            capture_output=True,
            text=True,
            timeout=_BUILDS_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        pytest.skip(f"sqlite3 was not built within {_BUILDS_S:.0f} s")
    if done.returncode:
        pytest.skip(f"sqlite3 cannot be built: {done.stderr.strip()[-300:]}")
