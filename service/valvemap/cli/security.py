"""``valvemap init`` and ``valvemap trust``: certificates, users, a first configuration."""

import secrets
from pathlib import Path
from typing import Annotated

import typer
from cryptography.hazmat.primitives.serialization import Encoding

from guarded_opcua import (
    OwnCertificate,
    Pki,
    Role,
    UserStore,
    ensure_certificate,
    load_certificate,
    rejected,
    thumbprint,
)
from guarded_opcua.security.certificate_rules import Use, name_of
from guarded_opcua.security.peer_certificates import PeerTrust
from guarded_opcua.security.pki_folders import trust as trust_certificate
from guarded_opcua.security.whole_files import write_owner_only
from valvemap.app.identities import (
    APPLICATION_NAME,
    APPLICATION_URI,
    PAGE_NAME,
    PAGE_URI,
    PAGE_USER,
    RIG_NAME,
    RIG_URI,
)
from valvemap.cli.options import FolderOption
from valvemap.cli.output import write_line
from valvemap.config.template import configuration_template
from valvemap.owned_files import naming, write_whole

_OWNERS = ("service", "rig")
_HOSTS = ["localhost", "127.0.0.1"]
_ROLES = {role.name.lower().replace("_", "-"): role for role in Role}


def init(
    data: FolderOption = Path("data"),
    service_host: Annotated[
        list[str] | None,
        typer.Option(
            envvar="VALVEMAP_SERVICE_HOSTS", help="Name under which clients reach the service."
        ),
    ] = None,
    rig_host: Annotated[
        list[str] | None,
        typer.Option(envvar="VALVEMAP_RIG_HOSTS", help="Name under which clients reach the rig."),
    ] = None,
    operator_password: Annotated[
        str | None,
        typer.Option(
            envvar="VALVEMAP_OPERATOR_PASSWORD",
            help="Password of the operator; default: a random one, printed once.",
        ),
    ] = None,
) -> None:
    """Create certificates, users and a configuration."""
    if data.exists() and not data.is_dir():
        raise typer.BadParameter(f"--data {data}: it is a file, a folder is needed")
    make_users(data, operator_password)
    service = _certificate(data, "service", APPLICATION_URI, APPLICATION_NAME, service_host)
    of_rig = _certificate(data, "rig", RIG_URI, RIG_NAME, rig_host)
    _trust_each_other(data, service, of_rig)
    _make_page(data, service, of_rig)
    _make_configuration(data, service_host or [])
    write_line(f"{data}: ready; `valvemap serve --config {data / 'service.toml'}` starts")


def trust(
    certificate: Annotated[
        str | None, typer.Argument(help="Certificate file, or the thumbprint of a rejected one.")
    ] = None,
    data: FolderOption = Path("data"),
    of: Annotated[
        str, typer.Option(help="Application that trusts it: service, rig or dashboard.")
    ] = "service",
    user: Annotated[
        str | None, typer.Option(metavar="NAME", help="Let this user log in with it.")
    ] = None,
    role: Annotated[
        str | None, typer.Option(help=f"What the user may do: {', '.join(_ROLES)}.")
    ] = None,
) -> None:
    """Trust a certificate of an application or user, or list the rejected ones."""
    if of not in _OWNERS:
        raise typer.BadParameter(f"--of {of}: allowed is one of {', '.join(_OWNERS)}")
    pki = Pki(data / "pki" / of)
    if user is not None or role is not None:
        if user is None or role is None or certificate is None:
            raise typer.BadParameter("a user's certificate needs --user NAME, --role ROLE and FILE")
        write_line(_trust_user(pki, data / "users.json", user, _role(role), Path(certificate)))
        return
    if certificate is None:
        for file in rejected(pki):
            write_line(f"{file.stem}  {load_certificate(file).subject.rfc4514_string()}")
        return
    write_line(f"trusted: {trust_certificate(pki, certificate)}")


def _trust_user(pki: Pki, users_file: Path, user: str, role: Role, file: Path) -> str:
    """Let a user log in with a certificate, or with those of an authority; return a sentence."""
    certificate = load_certificate(file)
    der = certificate.public_bytes(Encoding.DER)
    users = UserStore.load(users_file)
    users.add_certificate(user, role, der)
    account = users.accounts.get(user)
    assert account is not None  # noqa: S101 - it was just added
    # the server checks revocation lists, which may be added later
    trusted = PeerTrust(pki, require_crl=False)
    which = f"the certificate {name_of(certificate)}"
    if account.authority:
        trusted.check_authority(certificate, Use.USER)
        pki.make_folders()
        target = pki.issuers / f"{thumbprint(certificate)}.der"
        write_whole(target, der)
        which = (
            f"certificates of {name_of(certificate)} for CN={user}; its .crl goes beside {target}"
        )
    else:
        trusted.check(der, Use.USER, anchors=account.anchors)
    users.save(users_file)
    return f"user {user} ({role.name.lower()}) logs in with {which}"


def _role(text: str) -> Role:
    known = _ROLES.get(text.lower().replace("_", "-"))
    if known is None:
        raise typer.BadParameter(f"role {text!r}: allowed is one of {', '.join(_ROLES)}")
    return known


def _certificate(
    data: Path, whose: str, uri: str, application: str, hosts: list[str] | None
) -> OwnCertificate:
    names = tuple(dict.fromkeys([*(hosts or []), *_HOSTS]))
    own = ensure_certificate(Pki(data / "pki" / whose), uri, names, application.replace(" ", "-"))
    write_line(f"certificate of the {whose}: {own.certificate}")
    return own


def _trust_each_other(data: Path, service: OwnCertificate, of_rig: OwnCertificate) -> None:
    for whose, other in (("service", of_rig), ("rig", service)):
        trust_certificate(Pki(data / "pki" / whose), other.certificate)


def _make_page(data: Path, *servers: OwnCertificate) -> None:
    """Make a certificate and a read-only account for the live page."""
    page = _certificate(data, "dashboard", PAGE_URI, PAGE_NAME, None)
    trust_certificate(Pki(data / "pki" / "service"), page.certificate)
    trust_certificate(Pki(data / "pki" / "rig"), page.certificate)
    for server in servers:
        trust_certificate(Pki(data / "pki" / "dashboard"), server.certificate)
    secret_file, users_file = data / "dashboard-password", data / "users.json"
    users = UserStore.load(users_file)
    if secret_file.exists() and PAGE_USER in users.names:
        return
    users.add(PAGE_USER, Role.OBSERVER, _secret(secret_file))
    users.save(users_file)


def make_users(data: Path, operator_password: str | None) -> None:
    """Make users and passwords if there are none yet, and print them."""
    file = data / "users.json"
    if file.exists():
        write_line(f"users: {file} is kept")
        return
    users = UserStore()
    password = operator_password or secrets.token_urlsafe(12)
    users.add("operator", Role.OPERATOR, password)
    with naming(data):
        data.mkdir(parents=True, exist_ok=True)
    users.add("service", Role.OPERATOR, _secret(data / "source-password"))
    users.save(file)
    write_line(f"users: {file}")
    if operator_password is None:
        write_line(f"user operator, password {password} (shown this once)")


def _make_configuration(data: Path, hosts: list[str]) -> None:
    file = data / "service.toml"
    if file.exists():
        write_line(f"configuration: {file} is kept")
        return
    write_whole(file, configuration_template(data, hosts))
    write_line(f"configuration: {file}")


def _secret(file: Path) -> str:
    """Return the password in a file; if it is missing, write a new one."""
    with naming(file):
        if file.exists():
            return file.read_text(encoding="utf-8").partition("\n")[0]
        secret = secrets.token_urlsafe(24)
        write_owner_only(file, f"{secret}\n".encode())
        return secret
