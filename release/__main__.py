"""``python -m release``: build, describe and sign all that is published; see docs/release.md."""

import argparse
import shutil
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Final

from documentation.bill_of_materials import bill_of_materials
from release.bill import image_bill
from release.errors import ReleaseError, WrongUse
from release.images import BUILDERS, VARIANTS, Builder, build_image, find_builder, pack
from release.packages import Source, build_packages, export
from release.signing import check_key, sign

ROOT: Final = Path(__file__).parents[1]
LOCKS: Final = ("requirements-image.lock", "requirements-fleet.lock")
NO_BUILDER: Final = (
    f"no image builder can be used ({', '.join(builder.name for builder in BUILDERS)}): "
    "install one, or leave the images out with IMAGES=no"
)


def main(arguments: list[str]) -> int:
    """Build a release; return 0, 1 (the release failed) or 2 (wrong usage)."""
    parser = argparse.ArgumentParser(prog="release", description=__doc__)
    parser.add_argument("--key", default="", help="key that signs: a file of ssh-keygen")
    parser.add_argument("--out", default="", help="empty or new folder of the artefacts")
    parser.add_argument("--images", choices=("yes", "no"), default="yes")
    parser.add_argument("--base", default="", help="PYTHON_IMAGE of the Dockerfile, by its digest")
    given = parser.parse_args(arguments)
    try:
        with tempfile.TemporaryDirectory(prefix="valvemap-release-") as work:
            _release(given, Path(work))
    except ReleaseError as error:
        print(f"release: {error}", file=sys.stderr)  # noqa: T201
        return error.exit_code
    return 0


def _release(given: argparse.Namespace, work: Path) -> None:
    if not given.key:
        raise WrongUse("a key is needed: make release KEY=FILE (made by ssh-keygen)")
    key = Path(given.key).expanduser()
    check_key(key)
    version = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"]
    out = Path(given.out) if given.out else ROOT / "dist" / f"valvemap-{version}"
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise WrongUse(f"{out}: exists already; a new or empty folder is needed (DIST=FOLDER)")
    builder = find_builder() if given.images == "yes" else None
    if builder is None and given.images == "yes":
        raise ReleaseError(NO_BUILDER)
    source = export(ROOT, work / "source")

    made = work / "made"
    made.mkdir()
    _say(f"commit {source.commit}: wheel and sdist")
    build_packages(source, made, work)
    if builder is None:
        _say("images are left out (IMAGES=no)")
        bill = made / f"valvemap-{version}.cdx.json"
        bill.write_text(bill_of_materials(), encoding="utf-8")
    else:
        for variant in VARIANTS:
            _say(f"{variant}, by {builder.name}: some minutes")
            _image(builder, source, variant, version, given.base, made)
    allowed = sign(made, key, work)
    out.parent.mkdir(parents=True, exist_ok=True)
    if out.exists():
        out.rmdir()
    shutil.move(made, out)
    for file in sorted(out.iterdir()):
        _say(f"  {file}  {file.stat().st_size / 1e6:.1f} MB")
    _say(f"signed; users verify with this line in their file of allowed signers:\n{allowed}")


def _image(
    builder: Builder, source: Source, variant: str, version: str, base: str, made: Path
) -> None:
    name = f"valvemap-{version}-{variant}"
    file = made / f"{name}.tar"
    arguments = {**VARIANTS[variant], **({"PYTHON_IMAGE": base} if base else {})}
    tag = f"localhost/valvemap:{version}-{variant}"
    build_image(builder, source, tag, arguments, file)
    packed = pack(file)
    locks = [source.folder / lock for lock in LOCKS]
    bill = made / f"{name}.cdx.json"
    bill.write_text(image_bill(packed, locks, packed.name, version), encoding="utf-8")


def _say(line: str) -> None:
    print(line, flush=True)  # noqa: T201


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
