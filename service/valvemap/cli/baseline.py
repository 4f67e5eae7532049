"""``valvemap baseline``: the approved map of a new valve."""

import asyncio
import os
from pathlib import Path
from typing import Annotated

import typer

from valvemap.cli.options import FolderOption
from valvemap.cli.output import write_line

_PASSWORD = "VALVEMAP_PASSWORD"  # noqa: S105 - the name of a variable


def baseline(
    action: Annotated[
        str, typer.Argument(metavar="ACTION", help="show, compare, approve, roll-back or replaced.")
    ],
    valve: Annotated[str, typer.Argument(metavar="VALVE", help="Name of the valve.")],
    url: Annotated[
        str, typer.Option(metavar="URL", help="The running service.")
    ] = "opc.tcp://127.0.0.1:4841/valvemap/service/",
    estimator: Annotated[
        str, typer.Option(metavar="NAME", help="With compare: estimator whose map is compared.")
    ] = "Auto",
    user: Annotated[
        str | None,
        typer.Option(metavar="NAME", help=f"An operator; {_PASSWORD} is asked for if not set."),
    ] = None,
    security: Annotated[
        str, typer.Option(metavar="POLICY", help="Basic256Sha256, Aes256Sha256RsaPss or None.")
    ] = "Basic256Sha256",
    data: FolderOption = Path("data"),
) -> None:
    """Approve a valve's map as reference, compare with it, restore it."""
    from valvemap.app.baseline import Action, act
    from valvemap.app.page_access import Watched
    from valvemap.opcua_client.source_settings import Security

    if action not in set(Action):
        raise typer.BadParameter(f"ACTION {action!r}: allowed is one of {', '.join(Action)}")
    if security not in set(Security):
        raise typer.BadParameter(f"--security {security}: allowed is one of {', '.join(Security)}")
    password = None
    if user is not None:
        password = os.environ.get(_PASSWORD) or typer.prompt(f"password of {user}", hide_input=True)
    pki = data / "pki" / "dashboard"
    service = Watched(url, Security(security), pki, user, password)
    write_line(asyncio.run(act(service, valve, Action(action), estimator)))
