"""The stacks that sweep our servers: how each is started, and its version."""

import json
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from benchmarks.foreign_clients import versions
from support import go_peer, maven_peer, node_peer

TESTS = Path(__file__).parents[1]
O6_CLIENT = TESTS / "support" / "o6_client.py"
MILO_CLIENT = TESTS / "opcua" / "milo_client"


@dataclass(frozen=True)
class Stack:
    """``program`` returns its command, built or installed in a cache; skips where it cannot."""

    program: Callable[[Callable[[str], Path]], tuple]
    version: Callable[[], str]


def _of_node_opcua():
    package = json.loads((node_peer.FOLDER / "package.json").read_text(encoding="utf-8"))
    return package["dependencies"]["node-opcua-client"]


def _of_milo():
    pom = (MILO_CLIENT / "pom.xml").read_text(encoding="utf-8")
    return re.search(r"milo-sdk-client</artifactId>\s*<version>([\d.]+)", pom)[1]


STACKS = {
    "node-opcua": Stack(
        lambda cache: node_peer.program(cache("node_peer"), "client.cjs"), _of_node_opcua
    ),
    "gopcua": Stack(lambda _: go_peer.program(), lambda: versions()["gopcua"]),
    "Eclipse Milo": Stack(
        lambda cache: maven_peer.program(MILO_CLIENT, "valvemap.Client", cache("milo_client")),
        _of_milo,
    ),
    "open62541, in o6": Stack(lambda _: (sys.executable, O6_CLIENT), lambda: version("o6")),
}
