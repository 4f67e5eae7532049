"""``valvemap schema`` and ``valvemap unit``: what an editor and a machine that boots need."""

import json
import re
import sys
from pathlib import Path
from typing import Annotated

import typer

from valvemap.cli.output import write_line
from valvemap.errors import ConfigurationError

_USER = re.compile(r"[a-z_][a-z0-9_-]{0,30}")  # as useradd takes them
_UNIT = """\
# /etc/systemd/system/valvemap.service, made by `valvemap unit`:
#   useradd --system --home-dir {folder} {user}; chown -R {user} {folder}
#   systemctl daemon-reload; systemctl enable --now valvemap
[Unit]
Description=valvemap: hydraulic valves' flow maps, identified online over OPC UA
After=network-online.target time-sync.target
Wants=network-online.target

[Service]
ExecStart={command} serve --config {config}
WorkingDirectory={folder}
Environment=VALVEMAP_SOURCE__STARTUP_TIMEOUT_S=0
Environment=NUMBA_CACHE_DIR=/var/cache/valvemap
User={user}
KillSignal=SIGINT
TimeoutStopSec=60
Restart=on-failure
RestartSec=5
RestartPreventExitStatus=2
CacheDirectory=valvemap
UMask=0077
NoNewPrivileges=yes
ProtectSystem=strict
ProtectHome=read-only
ReadWritePaths={folder}
PrivateTmp=yes
PrivateDevices=yes
ProtectKernelTunables=yes
ProtectKernelModules=yes
ProtectControlGroups=yes
RestrictAddressFamilies=AF_INET AF_INET6 AF_UNIX
RestrictSUIDSGID=yes
LockPersonality=yes

[Install]
WantedBy=multi-user.target
"""


def schema() -> None:
    """Print the JSON schema of the configuration, for editors that complete and check TOML."""
    from valvemap.config.models import Config

    described = Config.model_json_schema()
    described["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    described["title"] = "valvemap configuration"
    write_line(json.dumps(described, indent=2, ensure_ascii=False))


def unit(
    config: Annotated[
        Path, typer.Option("--config", "-c", metavar="FILE", help="Configuration to serve by.")
    ],
    user: Annotated[str, typer.Option(metavar="NAME", help="Who runs it.")] = "valvemap",
) -> None:
    """Print a systemd unit that serves a configuration from boot on."""
    from valvemap.config.loading import load_config

    load_config(config)
    script = Path(sys.executable).with_name("valvemap")
    command = str(script) if script.exists() else f"{sys.executable} -m service"
    file, folder = config.absolute(), Path.cwd()  # relative paths in it are meant from here
    for text in (str(file), str(folder), command):
        if any(letter in text for letter in "%\n\"'\\"):
            raise ConfigurationError(f"{text}: systemd does not take such a name as it is")
    if not _USER.fullmatch(user):
        raise typer.BadParameter(f"--user {user!r}: small letters, digits, _ and - are allowed")
    write_line(_UNIT.format(command=command, config=file, folder=folder, user=user).rstrip())
