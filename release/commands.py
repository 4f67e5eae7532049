"""External programs: a failed call ends the release with its last error line."""

import os
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from release.errors import ReleaseError


def run(
    command: Sequence[str | Path],
    folder: Path | None = None,
    environment: Mapping[str, str] | None = None,
) -> str:
    """Run a program and return its output.

    Raises
    ------
    ReleaseError
        if the program fails, with its name and last error line.
    """
    words = [str(word) for word in command]
    try:
        done = subprocess.run(  # noqa: S603 - the programs of a release
            words,
            cwd=folder,
            env={**os.environ, **(environment or {})},
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
        )
    except OSError as error:
        raise ReleaseError(f"{words[0]}: {(error.strerror or str(error)).lower()}") from None
    if done.returncode:
        last = (done.stderr.strip() or done.stdout.strip() or "no output").splitlines()[-1]
        raise ReleaseError(f"{' '.join(words[:3])}: exit code {done.returncode}: {last}")
    return done.stdout
