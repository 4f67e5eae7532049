"""Node-RED without a screen: flows are deployed, and their buttons pressed, by its own web API."""

import json
import shutil
import time
from contextlib import contextmanager
from pathlib import Path

import httpx

from support.node_peer import installed
from support.processes import free_port, program

ROOT = Path(__file__).parents[2]
PACKAGES = ROOT / "tests" / "scada" / "programs"
FLOW = ROOT / "docs" / "how-to" / "node_red_flow.json"
_TAB = "valvemap"
_STARTS_S = 60.0
_ANSWERS_S = 60.0
_SETTINGS = """module.exports = {{
    uiHost: "127.0.0.1", uiPort: {port},
    telemetry: {{enabled: false}}, diagnostics: {{enabled: false}},
}};
"""


def flow(url, **security):
    """The example as a user imports it, its endpoint filled in."""
    nodes = json.loads(FLOW.read_text(encoding="utf-8"))
    (endpoint,) = (node for node in nodes if node["type"] == "OpcUa-Endpoint")
    endpoint |= {"endpoint": url, **security}
    return nodes


def signed(user, password):
    """What a user sets in the endpoint for a service outside a demo."""
    credentials = {"user": user, "password": password}
    return {
        "secpol": "Basic256Sha256",
        "secmode": "SignAndEncrypt",
        "none": False,
        "login": True,
        "credentials": credentials,
    }


class NodeRed:
    """A Node-RED that runs."""

    def __init__(self, http):
        self._http = http

    def deploy(self, nodes):
        """Put these nodes in place of what is there and what it kept, as *Deploy* does."""
        for flows in ([], nodes):
            self._http.post("/flows", json=flows).raise_for_status()

    def press(self, button):
        """Press the button of an inject node; while its flow starts there is none."""
        answer = self._http.post(f"/inject/{button}", json={})
        if answer.status_code != httpx.codes.NOT_FOUND:
            answer.raise_for_status()

    def values(self):
        """What the flow keeps of the newest values, by node: (value, status)."""
        context = self._http.get(f"/context/flow/{_TAB}")
        if context.status_code == httpx.codes.NOT_FOUND:
            return {}
        kept = context.raise_for_status().json().get("memory", {}).get("values")
        found = {} if kept is None else json.loads(kept["msg"])
        return {name: (one["value"], one["status"]) for name, one in found.items()}

    def once(self, good, press=()):
        """Wait for values that are good to the caller; press buttons meanwhile."""
        end = time.monotonic() + _ANSWERS_S
        while True:
            for button in press:
                self.press(button)
            time.sleep(0.5)
            values = self.values()
            if good(values):
                return values
            assert time.monotonic() < end, values


@contextmanager
def node_red(folder, cache):
    """Node-RED with its OPC UA nodes, nothing deployed; what it writes goes to the folder."""
    packages = installed(PACKAGES, cache)
    port = free_port()
    settings = folder / "settings.js"
    settings.write_text(_SETTINGS.format(port=port), encoding="utf-8")
    script = packages / "node_modules" / "node-red" / "red.js"
    command = (shutil.which("node"), script, "-u", folder, "-s", settings)
    env = {"HOME": str(folder), "XDG_CONFIG_HOME": str(folder)}  # its certificate goes there
    with (
        program(*command, env=env, log=folder / "node_red.log"),
        httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=20.0) as http,
    ):
        answers(http, "/flows", _STARTS_S)
        yield NodeRed(http)


def answers(http, path, seconds):
    """Wait until a server answers."""
    end = time.monotonic() + seconds
    while True:
        try:
            http.get(path).raise_for_status()
        except httpx.HTTPError:
            assert time.monotonic() < end, f"{http.base_url}{path} never answered"
            time.sleep(0.2)
        else:
            return
