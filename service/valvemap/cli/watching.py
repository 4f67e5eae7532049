"""Options of commands that connect to a running service as a client."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valvemap.config.secret_files import read_secret

if TYPE_CHECKING:
    from valvemap.app.page_access import Watched

SecurityOption = Annotated[str, typer.Option(help="Basic256Sha256, Aes256Sha256RsaPss, or None.")]
PasswordFileOption = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Its first line is the user's password.")
]
HostNameOption = Annotated[
    bool, typer.Option(help="The service's certificate must name the host of its url.")
]


def watched(
    url: str,
    data: Path,
    security: str,
    user: str | None,
    password_file: Path | None,
    *,
    check_host_name: bool,
    require_crl: bool,
    rig_url: str | None = None,
) -> "Watched":
    """Return the connection settings; the default user is the page's, as `init` creates it.

    Raises
    ------
    BadParameter
        naming the allowed values of ``security``.
    ConfigurationError
        if the password file cannot be read.
    """
    from valvemap.app.identities import PAGE_USER
    from valvemap.app.page_access import Watched
    from valvemap.opcua_client.source_settings import Security

    if security not in set(Security):
        raise typer.BadParameter(f"security {security!r}: allowed is one of {', '.join(Security)}")
    if user is None and security != Security.NONE:
        user = PAGE_USER
    return Watched(
        url=url,
        security=Security(security),
        pki=data / "pki" / "dashboard",
        user=user,
        password=None
        if user is None
        else read_secret(password_file or data / "dashboard-password"),
        rig_url=rig_url,
        check_host_name=check_host_name,
        require_crl=require_crl,
    )
