"""NameConstraints of authorities (RFC 5280, 4.2.1.10)."""

from collections.abc import Sequence
from urllib.parse import urlsplit

from cryptography import x509
from cryptography.x509.oid import NameOID

from guarded_opcua.security.certificate_rules import extension


def forbidden_name(path: Sequence[x509.Certificate]) -> str | None:
    """Return a name that violates the NameConstraints of an authority above.

    Parameters
    ----------
    path
        Certificates from the peer's up to the root.

    Returns
    -------
    str or None
        The first such name, None if all are permitted.
    """
    for number, authority in enumerate(path):
        constraints = extension(authority, x509.NameConstraints) if number else None
        if constraints is None:
            continue
        for below, certificate in enumerate(path[:number]):
            if below and certificate.subject == certificate.issuer:
                continue  # self-issued: exempt (RFC 5280, 6.1.3)
            for name in _names(certificate):
                if not _permitted(name, constraints):
                    return _text(name)
    return None


def _names(certificate: x509.Certificate) -> list[x509.GeneralName]:
    names: list[x509.GeneralName] = []
    if list(certificate.subject):
        names.append(x509.DirectoryName(certificate.subject))
    alternatives = extension(certificate, x509.SubjectAlternativeName)
    names += alternatives or []
    if not any(isinstance(name, x509.RFC822Name) for name in names):
        names += [
            x509.RFC822Name(str(attribute.value))
            for attribute in certificate.subject.get_attributes_for_oid(NameOID.EMAIL_ADDRESS)
            if str(attribute.value).isascii()
        ]
    return names


def _permitted(name: x509.GeneralName, constraints: x509.NameConstraints) -> bool:
    excluded = [c for c in constraints.excluded_subtrees or () if type(c) is type(name)]
    permitted = [c for c in constraints.permitted_subtrees or () if type(c) is type(name)]
    if not excluded and not permitted:
        return True
    if isinstance(name, x509.UniformResourceIdentifier) and not _host(name.value):
        return False  # no host, such as urn:…; RFC 5280 requires refusal
    try:
        return not any(_within(name, c) for c in excluded) and (
            not permitted or any(_within(name, c) for c in permitted)
        )
    except NotImplementedError:
        return False


def _within(name: x509.GeneralName, tree: x509.GeneralName) -> bool:
    match name, tree:
        case x509.DNSName(), x509.DNSName():
            return _is_below(name.value, tree.value.removeprefix("."))
        case x509.IPAddress(), x509.IPAddress():
            return name.value in tree.value  # type: ignore[operator] # a constraint is a network
        case x509.UniformResourceIdentifier(), x509.UniformResourceIdentifier():
            return _is_host(_host(name.value), tree.value)
        case x509.RFC822Name(), x509.RFC822Name():
            if "@" in tree.value:
                return name.value.lower() == tree.value.lower()
            return _is_host(name.value.rpartition("@")[2], tree.value)
        case x509.DirectoryName(), x509.DirectoryName():
            wanted = tree.value.rdns
            return name.value.rdns[: len(wanted)] == wanted
    raise NotImplementedError


def _is_host(host: str, tree: str) -> bool:
    """Return whether a host matches: ``.domain`` matches all hosts below, else it is one host."""
    if tree.startswith("."):
        return host.lower().endswith(tree.lower())
    return host.lower() == tree.lower()


def _is_below(host: str, tree: str) -> bool:
    host, tree = host.lower().rstrip("."), tree.lower().rstrip(".")
    return not tree or host == tree or host.endswith(f".{tree}")


def _host(uri: str) -> str:
    try:
        return urlsplit(uri).hostname or ""
    except ValueError:
        return ""


def _text(name: x509.GeneralName) -> str:
    value = name.value
    return value.rfc4514_string() if isinstance(value, x509.Name) else str(value)
