"""Bill of materials of the image, CycloneDX 1.6: ``python -m documentation.bill_of_materials``."""

import hashlib
import re
from collections.abc import Iterator, Sequence
from email.message import Message
from importlib import metadata
from importlib.metadata import PackageMetadata
from pathlib import Path

from cyclonedx.contrib.license.factories import LicenseFactory
from cyclonedx.model import HashAlgorithm, HashType
from cyclonedx.model.bom import Bom
from cyclonedx.model.component import Component, ComponentType
from cyclonedx.output.json import JsonV1Dot6
from packageurl import PackageURL

ROOT = Path(__file__).parents[1]
LOCK = ROOT / "requirements-image.lock"
VENDOR = ROOT / "service" / "valvemap" / "page" / "static" / "vendor"
OUT = ROOT / "sbom" / "valvemap.cdx.json"

_PINNED = re.compile(r"^([\w.-]+)==([^\s;]+)")
_HASH = re.compile(r"--hash=sha256:([0-9a-f]{64})")
_VENDORED = re.compile(
    r"^\| `([\w-]+)/` \| ([\d.]+) \| npm `([\w.-]+)`.*\| ([\w.-]+), ", re.MULTILINE
)


def main() -> None:
    """Write the bill of materials."""
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(bill_of_materials(), encoding="utf-8")
    print(OUT)  # noqa: T201


def bill_of_materials() -> str:
    """Return the packages of the image's lock file and the vendored scripts, as JSON."""
    bom = Bom()
    own = Component(
        name="valvemap",
        version=metadata.version("valvemap"),
        type=ComponentType.APPLICATION,
        bom_ref="valvemap",
        purl=PackageURL("pypi", None, "valvemap", metadata.version("valvemap")),
        licenses=[LicenseFactory().make_from_string("Apache-2.0")],
    )
    bom.metadata.component = own
    parts = [*_packages(), *vendored_scripts()]
    for part in parts:
        bom.components.add(part)
    bom.register_dependency(own, parts)
    return JsonV1Dot6(bom).output_as_string(indent=2) + "\n"


def locked_digests(lock: Path) -> dict[tuple[str, str], list[str]]:
    """Return the SHA-256 digests by name and version of a lock file; a release may have several."""
    found = {}
    for block in re.split(r"\n(?=\S)", lock.read_text(encoding="utf-8")):
        if pinned := _PINNED.match(block):
            name, version = pinned.groups()
            found[name, version] = _HASH.findall(block)
    return found


def vendored_scripts() -> Iterator[Component]:
    """Yield the vendored scripts of the web page, from the table in their README."""
    table = (VENDOR / "README.md").read_text(encoding="utf-8")
    for folder, version, package, licence in _VENDORED.findall(table):
        files = sorted((VENDOR / folder).glob("*.*"))
        digests = [hashlib.sha256(file.read_bytes()).hexdigest() for file in files]
        yield component(package, version, "npm", digests, licence)


def component(
    name: str,
    version: str,
    purl: PackageURL | str,
    digests: Sequence[str] = (),
    licence: str | None = None,
) -> Component:
    """Return one component; ``purl`` may be the name of its registry."""
    if isinstance(purl, str):
        purl = PackageURL(purl, None, name, version)
    return Component(
        name=name,
        version=version,
        type=ComponentType.LIBRARY,
        bom_ref=purl.to_string(),
        purl=purl,
        hashes=[HashType(alg=HashAlgorithm.SHA_256, content=digest) for digest in digests],
        licenses=[] if licence is None else [LicenseFactory().make_from_string(licence)],
    )


def licence_of(metadata_of_package: PackageMetadata | Message) -> str | None:
    """Return the licence in a package's metadata, if it is short enough for a name."""
    fields = (name for name in ("License-Expression", "License") if name in metadata_of_package)
    text = next((metadata_of_package[name] for name in fields), "")
    return text if 0 < len(text) < 60 and "\n" not in text else None


def _packages() -> Iterator[Component]:
    for (name, version), digests in locked_digests(LOCK).items():
        yield component(name, version, "pypi", digests, _licence(name))


def _licence(package: str) -> str | None:
    try:
        return licence_of(metadata.metadata(package))
    except metadata.PackageNotFoundError:  # of another platform
        return None


if __name__ == "__main__":
    main()
