"""Container images, built with the first available program: buildah, podman or docker."""

import gzip
import os
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from release.commands import run
from release.packages import Source

VARIANTS: Final[Mapping[str, Mapping[str, str]]] = {
    "image": {},
    "fleet-image": {"FLEET": "yes"},
}
"""Images of the Dockerfile by name in a release, with their build arguments."""

_COMPRESSION: Final = 6


@dataclass(frozen=True)
class Builder:
    """A program that builds images; ``{…}`` in its arguments are placeholders.

    Images are saved in Docker's format, since the OCI format has no health check.
    """

    name: str
    build: tuple[str, ...]
    save: tuple[str, ...]
    check: tuple[str, ...]
    environment: tuple[tuple[str, str], ...] = ()

    def is_there(self) -> bool:
        """Return whether the program is installed and, if it is a client, its server responds."""
        if shutil.which(self.name) is None:
            return False
        asked = [self.name, *self.check]
        done = subprocess.run(asked, capture_output=True, check=False)  # noqa: S603 - of the table
        return done.returncode == 0


BUILDERS: Final = (
    Builder(
        "buildah",
        ("build", "--format=docker", "--timestamp={epoch}"),
        ("push", "{tag}", "docker-archive:{file}:{tag}"),
        ("--version",),
        (("BUILDAH_ISOLATION", "chroot"),),  # works without user namespaces
    ),
    Builder(
        "podman",
        ("build", "--format=docker", "--timestamp={epoch}"),
        ("save", "--format=docker-archive", "--output={file}", "{tag}"),
        ("info",),
    ),
    Builder("docker", ("build",), ("save", "--output={file}", "{tag}"), ("info",)),
)


def find_builder() -> Builder | None:
    """Return the first usable builder, or None."""
    return next((builder for builder in BUILDERS if builder.is_there()), None)


def build_image(
    builder: Builder, source: Source, tag: str, arguments: Mapping[str, str], file: Path
) -> None:
    """Build one image of the source's Dockerfile; save it in the format of `docker save`."""
    words = {"tag": tag, "file": str(file), "epoch": str(source.epoch)}
    given = [f"--build-arg={name}={value}" for name, value in arguments.items()]
    environment = {n: os.environ.get(n, value) for n, value in builder.environment}
    build = [word.format(**words) for word in builder.build]
    run([builder.name, *build, f"--tag={tag}", *given, source.folder], None, environment)
    save = [word.format(**words) for word in builder.save]
    run([builder.name, *save], None, environment)


def pack(file: Path) -> Path:
    """Compress an archive without name and time; remove the uncompressed one."""
    packed = file.with_suffix(file.suffix + ".gz")
    with (
        file.open("rb") as plain,
        packed.open("wb") as out,
        gzip.GzipFile("", "wb", _COMPRESSION, out, mtime=0) as compressed,
    ):
        shutil.copyfileobj(plain, compressed, 1 << 20)
    file.unlink()
    return packed
