"""Files of an image, read from its archive (`docker save`) layer by layer."""

import json
import tarfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Final

from release.errors import ReleaseError

_GONE: Final = ".wh."  # prefix of a file that a layer removes
_OPAQUE: Final = ".wh..wh..opq"  # marks a folder whose contents a layer removes
_MOST_BYTES: Final = 64 << 20  # maximum size of one file, 100 times the largest package database


@dataclass(frozen=True)
class ImageFiles:
    """The requested files of an image, and its environment variables."""

    files: Mapping[str, bytes]
    environment: Mapping[str, str]


def read_image(archive: Path, wanted: Callable[[str], bool]) -> ImageFiles:
    """Read files of an image by path (``usr/lib/os-release``), in the state of its last layer.

    Raises
    ------
    ReleaseError
        if the archive does not contain exactly one image.
    """
    files: dict[str, bytes] = {}
    try:
        with tarfile.open(archive) as outer:
            (image,) = json.load(_member(outer, "manifest.json"))
            config = json.load(_member(outer, image["Config"]))
            for layer in image["Layers"]:
                with tarfile.open(fileobj=_member(outer, layer)) as inner:
                    _apply(inner, files, wanted)
    except (tarfile.TarError, KeyError, TypeError, ValueError) as error:
        raise ReleaseError(f"{archive}: not an archive of one image: {error}") from None
    pairs = (pair.partition("=") for pair in (config.get("config") or {}).get("Env") or [])
    return ImageFiles(files, {name: value for name, _, value in pairs})


def _apply(layer: tarfile.TarFile, files: dict[str, bytes], wanted: Callable[[str], bool]) -> None:
    """Apply one layer: remove the files that it deletes, then add its files."""
    added: dict[str, bytes] = {}
    for member in layer:
        path = PurePosixPath("/", member.name).relative_to("/")
        if path.name == _OPAQUE:
            _remove_below(files, str(path.parent))
        elif path.name.startswith(_GONE):
            _remove(files, str(path.with_name(path.name.removeprefix(_GONE))))
        elif member.isdir():
            files.pop(str(path), None)
        else:
            _remove(files, str(path))
            for folder in path.parents:  # which replace files of the same name
                files.pop(str(folder), None)
            if member.isreg() and wanted(str(path)):
                if member.size > _MOST_BYTES:
                    raise ReleaseError(f"{path}: {member.size} bytes; {_MOST_BYTES} are allowed")
                added[str(path)] = _member(layer, member).read()
    files.update(added)


def _remove(files: dict[str, bytes], path: str) -> None:
    files.pop(path, None)
    _remove_below(files, path)


def _remove_below(files: dict[str, bytes], folder: str) -> None:
    inside = f"{folder}/" if folder != "." else ""
    for path in [path for path in files if path.startswith(inside)]:
        del files[path]


def _member(archive: tarfile.TarFile, member: Any) -> Any:  # noqa: ANN401 - a name or its entry
    found = archive.extractfile(member)
    if found is None:
        raise ReleaseError(f"{getattr(member, 'name', member)}: not a file of the archive")
    return found
