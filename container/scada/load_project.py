# ruff: noqa: INP001 - a script on its own
"""Give a FUXA that has no project yet the one of docs/how-to, and say which service it is for.

``load_project.py PROJECT --fuxa URL --service URL``; a service outside a demo also needs
``--security Basic256Sha256 --user NAME --password-file FILE``. ``--driver`` lets FUXA install its
OPC UA driver (from npm), which its image does not hold.
"""

import argparse
import json
import sys
import time
import urllib.request
from pathlib import Path

STARTS_S = 300.0  # FUXA makes its databases at its first start
ANSWERS_S = 600.0  # it installs a driver before it answers
SIGN_AND_ENCRYPT = "3"  # MessageSecurityMode, as FUXA keeps it
POLICIES = "http://opcfoundation.org/UA/SecurityPolicy#"
DRIVER = "node-opcua"


def main() -> None:
    """Load the project."""
    asked = arguments(sys.argv[1:])
    project = json.loads(asked.project.read_text(encoding="utf-8"))
    (device,) = project["devices"].values()
    device["property"]["address"] = asked.service
    if _wait_for(asked.fuxa).get("devices"):
        print("FUXA has a project; it is kept")  # noqa: T201 - a script
        return
    if asked.driver:
        _install_driver(asked.fuxa)
    params = {"query": "security", "name": device["id"], "value": _security(asked)}
    _request(asked.fuxa, "device", {"params": params})
    _request(asked.fuxa, "project", project)


def arguments(words: list[str]) -> argparse.Namespace:
    """What is asked for on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("project", type=Path)
    parser.add_argument("--fuxa", required=True, metavar="URL")
    parser.add_argument("--service", required=True, metavar="URL")
    parser.add_argument("--security", choices=["Basic256Sha256", "Aes256_Sha256_RsaPss"])
    parser.add_argument("--user")
    parser.add_argument("--password-file", type=Path)
    parser.add_argument("--driver", action="store_true")
    return parser.parse_args(words)


def _security(asked: argparse.Namespace) -> dict[str, object]:
    found: dict[str, object] = {}
    if asked.security:
        policy = POLICIES + asked.security
        found["mode"] = {"securityMode": SIGN_AND_ENCRYPT, "securityPolicy": policy}
    if asked.user:
        password = asked.password_file.read_text(encoding="utf-8").splitlines()[0]
        found |= {"uid": asked.user, "pwd": password}
    return found


def _wait_for(fuxa: str) -> dict[str, object]:
    """The project that it has, as soon as it answers."""
    end = time.monotonic() + STARTS_S
    while True:
        try:
            return _request(fuxa, "project")
        except OSError as error:
            if time.monotonic() > end:
                sys.exit(f"{fuxa}: {error}")
            time.sleep(1.0)


def _install_driver(fuxa: str) -> None:
    known = {plugin["name"]: plugin for plugin in _request(fuxa, "plugins")}
    if not known[DRIVER]["current"]:
        _request(fuxa, "plugins", {"params": known[DRIVER]})


def _request(fuxa: str, path: str, body: object = None):  # noqa: ANN202 - any JSON
    data = None if body is None else json.dumps(body).encode()
    headers = {"Content-Type": "application/json"}
    request = urllib.request.Request(f"{fuxa}/api/{path}", data, headers)  # noqa: S310 - as given
    with urllib.request.urlopen(request, timeout=ANSWERS_S) as answer:  # noqa: S310
        text = answer.read()
    return json.loads(text) if text else None


if __name__ == "__main__":
    main()
