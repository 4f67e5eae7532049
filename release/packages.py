"""Wheel and sdist, from the committed tree and locked tools: the same bytes at each build."""

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
    """A committed tree, exported.

    Attributes
    ----------
    folder
        Holds its files, and nothing that is not committed.
    commit
        Its full name.
    epoch
        Its time, seconds since 1970: every time stamp inside the artefacts (SOURCE_DATE_EPOCH).
    """

    folder: Path
    commit: str
    epoch: int


def export(repository: Path, folder: Path) -> Source:
    """Export the commit that is checked out.

    Raises
    ------
    ReleaseError
        if files differ from the commit: a release is made of committed files alone.
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
    """Build wheel and sdist with the tools of their lock file, in an environment of its own."""
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
