"""Connection settings of the live page and of commands that access a running service."""

from dataclasses import dataclass
from pathlib import Path

from guarded_opcua.security.own_certificate import ensure_certificate
from guarded_opcua.security.pki_folders import Pki
from valvemap.app.identities import PAGE_NAME, PAGE_URI
from valvemap.opcua_client.source_settings import Security, SourceSettings


@dataclass(frozen=True)
class Watched:
    """The service to connect to.

    ``rig_url`` is the URL of a demo's rig; ``pki`` is the folder of our certificate, unused if
    ``security`` is NONE.
    """

    url: str
    security: Security
    pki: Path
    user: str | None = None
    password: str | None = None
    rig_url: str | None = None
    check_host_name: bool = True
    require_crl: bool = True


def settings_of(watched: Watched, timeout_s: float = SourceSettings.timeout_s) -> SourceSettings:
    """Return the connection settings; ``timeout_s`` is the timeout of every request."""
    own = None
    if watched.security is not Security.NONE:
        file_name = PAGE_NAME.replace(" ", "-")
        names = ("localhost", "127.0.0.1")
        own = ensure_certificate(Pki(watched.pki), PAGE_URI, names, file_name)
    return SourceSettings(
        url=watched.url,
        security=watched.security,
        pki=None if own is None else Pki(watched.pki),
        own=own,
        user=watched.user,
        password=watched.password,
        check_host_name=watched.check_host_name,
        require_crl=watched.require_crl,
        application_uri=None if own is not None else PAGE_URI,
        timeout_s=timeout_s,
    )
