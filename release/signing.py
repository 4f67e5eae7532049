"""The list of checksums, signed by `ssh-keygen -Y sign` with a key from a file or an agent."""

import hashlib
from pathlib import Path

from release.commands import run
from release.errors import ReleaseError, WrongUse
from release.verify import IDENTITY, NAMESPACE, SUMS, faults


def check_key(key: Path) -> None:
    """Check that the key exists, before the build starts.

    Raises
    ------
    WrongUse
    """
    if not key.is_file():
        raise WrongUse(f"{key}: no such key; `ssh-keygen -t ed25519 -f FILE` makes one")


def sign(folder: Path, key: Path, work: Path) -> str:
    """Sign all files of a folder; return the allowed-signers line of the key.

    Raises
    ------
    ReleaseError
        if the key cannot be used, or the signature does not verify.
    """
    lines = []
    for file in sorted(folder.iterdir()):
        with file.open("rb") as opened:
            lines.append(f"{hashlib.file_digest(opened, 'sha256').hexdigest()}  {file.name}\n")
    (folder / SUMS).write_text("".join(lines), encoding="ascii")
    run(["ssh-keygen", "-q", "-Y", "sign", "-f", key, "-n", NAMESPACE, folder / SUMS])
    kind, secret_free = _public(key).split()[:2]
    allowed = f'{IDENTITY} namespaces="{NAMESPACE}" {kind} {secret_free}'
    signers = work / "allowed_signers"
    signers.write_text(allowed + "\n", encoding="ascii")
    for fault in faults(folder, signers):
        raise ReleaseError(fault)
    return allowed


def _public(key: Path) -> str:
    """Return the public key: the file itself (the agent has the secret), its .pub, or derived."""
    beside = key.with_name(key.name + ".pub")
    for file in (key, beside):
        if file.suffix == ".pub" and file.is_file():
            return file.read_text(encoding="ascii")
    return run(["ssh-keygen", "-y", "-f", key])
