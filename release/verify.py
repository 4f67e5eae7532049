"""Verify a release: ``python3 verify.py FOLDER ALLOWED_SIGNERS``; requires only ssh-keygen.

The signature of SHA256SUMS is verified first, then every file is compared with the verified list. A
missing, changed or unlisted file is an error, and so is anything except plain files. Exit code 0:
all files match; 1: verification failed; 2: wrong usage.
"""

import base64
import hashlib
import re
import subprocess
import sys
from pathlib import Path

SUMS, SIGNATURE = "SHA256SUMS", "SHA256SUMS.sig"
NAMESPACE, IDENTITY = "valvemap-release", "valvemap"

_BEGIN, _END = b"-----BEGIN SSH SIGNATURE-----", b"-----END SSH SIGNATURE-----"
_LINE = re.compile(r"([0-9a-f]{64})  ([A-Za-z0-9][A-Za-z0-9._+-]*)")


class Refused(Exception):  # noqa: N818 - it says what happened
    """The list of checksums is missing, unsigned or malformed."""


def faults(folder: Path, signers: Path) -> list[str]:
    """Return the faults of a release, one line each; empty if all files match."""
    try:
        there = _plain_files(folder)
        listed = _listed(folder, _signed_sums(folder, there, signers))
    except Refused as error:
        return [str(error)]
    found = [f"{folder / name}: missing" for name in sorted(listed.keys() - there.keys())]
    more = there.keys() - listed.keys() - {SUMS, SIGNATURE}
    found += [f"{folder / name}: not listed in {SUMS}" for name in sorted(more)]
    for name in sorted(listed.keys() & there.keys()):
        if _sha256(there[name]) != listed[name]:
            found.append(f"{folder / name}: changed")
    return found


def _plain_files(folder: Path) -> dict[str, Path]:
    """Return the files of the folder by name; refuse links and folders."""
    try:
        there = {path.name: path for path in folder.iterdir()}
    except OSError as error:
        raise Refused(f"{folder}: {(error.strerror or str(error)).lower()}") from None
    for path in there.values():
        if path.is_symlink() or not path.is_file():
            raise Refused(f"{path}: not a plain file")
    return there


def _signed_sums(folder: Path, there: dict[str, Path], signers: Path) -> bytes:
    """Return the list of checksums, signed by an allowed signer."""
    for needed in (SUMS, SIGNATURE):
        if needed not in there:
            raise Refused(f"{folder / needed}: no such file")
    if not _is_canonical(there[SIGNATURE].read_bytes()):
        raise Refused(f"{there[SIGNATURE]}: not a signature as ssh-keygen writes it")
    if not signers.is_file():
        raise Refused(f"{signers}: no such file; it has a line for each allowed signer")
    sums = there[SUMS].read_bytes()
    command = ["ssh-keygen", "-Y", "verify", "-f", str(signers), "-I", IDENTITY, "-n", NAMESPACE]
    command += ["-s", str(there[SIGNATURE])]
    try:
        done = subprocess.run(command, input=sums, capture_output=True, check=False)  # noqa: S603
    except OSError as error:
        raise Refused(f"ssh-keygen: {error.strerror}") from None
    if done.returncode:
        said = (done.stderr + done.stdout).decode(errors="replace").strip().splitlines()
        reason = said[-1] if said else f"exit code {done.returncode}"
        raise Refused(f"{there[SUMS]}: signature refused: {reason}")
    return sums


def _is_canonical(armoured: bytes) -> bool:
    """Return whether a signature has its canonical form; ssh-keygen also accepts others."""
    first, *lines, last, end = armoured.split(b"\n") if armoured.count(b"\n") > 3 else [b""] * 4
    if (first, last, end) != (_BEGIN, _END, b""):
        return False
    text = b"".join(lines)
    width = len(lines[0])
    try:
        same = base64.b64encode(base64.b64decode(text, validate=True)) == text
    except ValueError:
        return False
    cut = [text[at : at + width] for at in range(0, len(text), width or 1)]
    return same and cut == lines


def _listed(folder: Path, sums: bytes) -> dict[str, str]:
    """Return the checksum by file name; each line must be valid, each file unique."""
    lines = sums.decode("ascii", errors="replace").splitlines()
    matches = [_LINE.fullmatch(line) for line in lines]
    listed = {match[2]: match[1] for match in matches if match is not None}
    if not listed or len(listed) != len(lines) or {SUMS, SIGNATURE} & listed.keys():
        raise Refused(f"{folder / SUMS}: not a list of SHA-256 sums and file names")
    return listed


def _sha256(file: Path) -> str:
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


def main(arguments: list[str]) -> int:
    """Verify a release; print the faults or the result."""
    if len(arguments) != 2 or not all(arguments):
        print("usage: verify.py FOLDER ALLOWED_SIGNERS", file=sys.stderr)  # noqa: T201
        return 2
    folder, signers = map(Path, arguments)
    found = faults(folder, signers)
    for line in found:
        print(line, file=sys.stderr)  # noqa: T201
    if found:
        return 1
    print(f"{folder}: {sum(1 for _ in folder.iterdir()) - 2} files as signed")  # noqa: T201
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
