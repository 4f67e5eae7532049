"""``valvemap schema`` and ``valvemap unit``: a JSON schema for editors, a systemd unit."""

import json
import re
import sys
from pathlib import Path
from typing import Annotated, Final

import typer

from valvemap.cli.output import write_line
from valvemap.errors import ConfigurationError

START_S: Final = 600  # s; the first start of a machine compiles all kernels before it is ready
WATCHDOG_S: Final = 60  # s; a connected source's supervisor ticks every 0.25 s
MEMORY_MIB: Final = 1_024  # MiB; twice the peak of a start that compiles all kernels (470 MiB)
VALVE_MIB: Final = 1  # MiB; ten times the state of a valve (docs/performance.md), including queues

_USER = re.compile(r"[a-z_][a-z0-9_-]{0,30}")  # names accepted by useradd
_UNIT = """\
# /etc/systemd/system/valvemap.service, made by `valvemap unit`:
#   useradd --system --home-dir {folder} {user}; chown -R {user} {folder}
#   systemctl daemon-reload; systemctl enable --now valvemap
[Unit]
Description=valvemap: hydraulic valves' flow maps, identified online over OPC UA
After=network-online.target time-sync.target
Wants=network-online.target

[Service]
Type=notify
ExecStart={command} serve --config {config}
ExecReload=/bin/kill -HUP $MAINPID
WorkingDirectory={folder}
Environment=VALVEMAP_SOURCE__STARTUP_TIMEOUT_S=0
Environment=NUMBA_CACHE_DIR=/var/cache/valvemap
User={user}
KillSignal=SIGINT
TimeoutStartSec={start_s}
TimeoutStopSec=60
WatchdogSec={watchdog_s}
Restart=on-failure
RestartSec=5
RestartPreventExitStatus=2
CacheDirectory=valvemap
MemoryMax={memory_mib}M
UMask=0077
NoNewPrivileges=yes
CapabilityBoundingSet=
AmbientCapabilities=
SystemCallFilter=@system-service
SystemCallFilter=~@privileged
SystemCallErrorNumber=EPERM
SystemCallArchitectures=native
ProtectSystem=strict
ProtectHome=read-only
ReadWritePaths={folder}
PrivateTmp=yes
PrivateDevices=yes
ProtectProc=invisible
ProtectClock=yes
ProtectHostname=yes
ProtectKernelLogs=yes
ProtectKernelTunables=yes
ProtectKernelModules=yes
ProtectControlGroups=yes
RemoveIPC=yes
RestrictAddressFamilies=AF_INET AF_INET6 AF_UNIX
RestrictNamespaces=yes
RestrictRealtime=yes
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
        Path, typer.Option("--config", "-c", metavar="FILE", help="Configuration of the service.")
    ],
    user: Annotated[
        str, typer.Option(metavar="NAME", help="User that runs the service.")
    ] = "valvemap",
) -> None:
    """Print a systemd unit that serves a configuration from boot on."""
    from valvemap.config.loading import load_config

    valves = len(load_config(config).valves)
    script = Path(sys.executable).with_name("valvemap")
    command = str(script) if script.exists() else f"{sys.executable} -m service"
    file, folder = config.absolute(), Path.cwd()  # relative paths in it refer to this folder
    for text in (str(file), str(folder), command):
        if any(letter in text for letter in "%\n\"'\\"):
            raise ConfigurationError(f"{text}: systemd does not take such a name as it is")
    if not _USER.fullmatch(user):
        raise typer.BadParameter(f"--user {user!r}: small letters, digits, _ and - are allowed")
    text = _UNIT.format(
        command=command,
        config=file,
        folder=folder,
        user=user,
        start_s=START_S,
        watchdog_s=WATCHDOG_S,
        memory_mib=MEMORY_MIB + VALVE_MIB * valves,
    )
    write_line(text.rstrip())
