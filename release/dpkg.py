"""System packages, from the database of dpkg (as read by `dpkg-query`)."""

import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

STATUS = "var/lib/dpkg/status"
STATUS_FOLDER = "var/lib/dpkg/status.d/"  # images without dpkg have a file per package
OS_RELEASE = ("usr/lib/os-release", "etc/os-release")


@dataclass(frozen=True)
class SystemPackage:
    """One installed package; ``source`` is the package that it was built from."""

    name: str
    version: str
    architecture: str
    source: str


@dataclass(frozen=True)
class Distribution:
    """ID and VERSION_ID of os-release, ``debian`` and ``12``."""

    id: str
    version: str


def is_database(path: str) -> bool:
    """Return whether a file belongs to the database."""
    return path == STATUS or (path.startswith(STATUS_FOLDER) and not path.endswith(".md5sums"))


def installed(text: str) -> Iterator[SystemPackage]:
    r"""Yield the installed packages of a status file; removed ones may have entries, too.

    Examples
    --------
    >>> text = "Package: a\nStatus: install ok installed\nVersion: 1\nArchitecture: all\n"
    >>> list(installed(text))
    [SystemPackage(name='a', version='1', architecture='all', source='a')]
    """
    for paragraph in text.split("\n\n"):
        fields = _fields(paragraph)
        is_installed = fields.get("Status", "install ok installed").split()[-1:] == ["installed"]
        if "Package" in fields and "Version" in fields and is_installed:
            name = fields["Package"]
            yield SystemPackage(
                name=name,
                version=fields["Version"],
                architecture=fields.get("Architecture", ""),
                source=fields.get("Source", name).partition(" ")[0],
            )


def distribution(text: str) -> Distribution:
    """Return the distribution of an os-release file; default ``linux`` (os-release(5))."""
    values = {}
    for line in text.splitlines():
        name, is_there, value = line.partition("=")
        if is_there and not name.startswith("#"):
            values[name.strip()] = "".join(shlex.split(value))
    return Distribution(values.get("ID", "linux"), values.get("VERSION_ID", ""))


def _fields(paragraph: str) -> Mapping[str, str]:
    """Return the fields of one paragraph, without continuation lines."""
    found = {}
    for line in paragraph.splitlines():
        name, is_there, value = line.partition(":")
        if is_there and not line[0].isspace():
            found[name] = value.strip()
    return found
