"""Wheel and sdist, built reproducibly from the committed tree with locked tools."""

import io
import sys
import tarfile
import venv
from dataclasses import dataclass
from pathlib import Path

from release.commands import run
from release.errors import ReleaseError

TOOLS = "requirements-release.lock"


@dataclass(frozen=True)
class Source:
    """An exported commit.

    Attributes
    ----------
    folder
        Folder with the committed files only.
    commit
        Full hash of the commit.
    epoch
        Time of the commit, s since 1970; all timestamps in the artefacts (SOURCE_DATE_EPOCH).
    """

    folder: Path
    commit: str
    epoch: int


def export(repository: Path, folder: Path) -> Source:
    """Export the checked-out commit.

    Raises
    ------
    ReleaseError
        if files differ from the commit, since a release contains only committed files.
    """
    git: list[str | Path] = ["git", "-C", repository]
    changed = run([*git, "status", "--porcelain"]).splitlines()
    if changed:
        raise ReleaseError(f"{len(changed)} files are not committed: commit or stash them first")
    commit = run([*git, "rev-parse", "HEAD"]).strip()
    packed = folder.with_suffix(".tar")
    run([*git, "archive", "--format=tar", f"--output={packed}", commit])
    with tarfile.open(fileobj=io.BytesIO(packed.read_bytes())) as archive:
        archive.extractall(folder, filter="data")
    packed.unlink()
    return Source(folder, commit, int(run([*git, "show", "-s", "--format=%ct", commit])))


def build_packages(source: Source, out: Path, work: Path) -> None:
    """Build wheel and sdist in a new environment with the tools of the lock file."""
    tools = work / "tools"
    venv.create(tools, with_pip=True)
    python = tools / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    pip: list[str | Path] = [
        python,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
    ]
    run([*pip, "--require-hashes", "--only-binary=:all:", "-r", source.folder / TOOLS])
    build: list[str | Path] = [python, "-m", "hatchling", "build", "--directory", out]
    run(build, source.folder, {"SOURCE_DATE_EPOCH": str(source.epoch)})
