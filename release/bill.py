"""Bill of materials of an image, CycloneDX: Python and system packages, scripts of the page."""

import hashlib
import re
from collections.abc import Iterator
from email.parser import BytesHeaderParser
from pathlib import Path
from typing import Final

from cyclonedx.model import HashAlgorithm, HashType
from cyclonedx.model.bom import Bom
from cyclonedx.model.component import Component, ComponentType
from cyclonedx.output.json import JsonV1Dot6
from packageurl import PackageURL

from documentation.bill_of_materials import (
    component,
    licence_of,
    locked_digests,
    vendored_scripts,
)
from release.dpkg import OS_RELEASE, STATUS, distribution, installed, is_database
from release.errors import ReleaseError
from release.image_archive import ImageFiles, read_image

_METADATA: Final = re.compile(r"(^|/)[^/]+\.(dist-info/METADATA|egg-info/PKG-INFO)$")
_INTERPRETER: Final = "PYTHON_VERSION"  # of the base image, whose Python dpkg does not list


def image_bill(archive: Path, locks: list[Path], name: str, version: str) -> str:
    """Return all packages and versions of an image, read from its files, as JSON.

    Raises
    ------
    ReleaseError
        if the image has no database of system packages, so the bill would be incomplete.
    """
    image = read_image(archive, _is_wanted)
    parts = {str(part.purl): part for part in _parts(image, locks)}
    with archive.open("rb") as opened:
        digest = hashlib.file_digest(opened, "sha256").hexdigest()
    own = Component(
        name=name,
        version=version,
        type=ComponentType.CONTAINER,
        bom_ref=name,
        hashes=[HashType(alg=HashAlgorithm.SHA_256, content=digest)],
    )
    bom = Bom()
    bom.metadata.component = own
    for part in parts.values():
        bom.components.add(part)
    bom.register_dependency(own, parts.values())
    return JsonV1Dot6(bom).output_as_string(indent=2) + "\n"


def _is_wanted(path: str) -> bool:
    return is_database(path) or path in OS_RELEASE or _METADATA.search(path) is not None


def _parts(image: ImageFiles, locks: list[Path]) -> Iterator[Component]:
    yield from _system_packages(image)
    yield from _python_packages(image, locks)
    yield from vendored_scripts()
    if _INTERPRETER in image.environment:
        yield component("python", image.environment[_INTERPRETER], "generic")


def _system_packages(image: ImageFiles) -> Iterator[Component]:
    databases = [path for path in image.files if is_database(path)]
    if not databases:
        raise ReleaseError(f"no database of system packages in the image ({STATUS})")
    named = next((image.files[path] for path in OS_RELEASE if path in image.files), b"")
    system = distribution(named.decode())
    for path in databases:
        for package in installed(image.files[path].decode()):
            qualifiers = {"arch": package.architecture, "distro": f"{system.id}-{system.version}"}
            if package.source != package.name:
                qualifiers["upstream"] = package.source
            purl = PackageURL("deb", system.id, package.name, package.version, qualifiers)
            yield component(package.name, package.version, purl)


def _python_packages(image: ImageFiles, locks: list[Path]) -> Iterator[Component]:
    digests = {key: found for lock in locks for key, found in locked_digests(lock).items()}
    for path, content in image.files.items():
        if _METADATA.search(path):
            said = BytesHeaderParser().parsebytes(content)
            name, version = str(said["Name"]), str(said["Version"])
            known = digests.get((re.sub(r"[-_.]+", "-", name).lower(), version), [])
            yield component(name, version, "pypi", known, licence_of(said))
