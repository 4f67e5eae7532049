"""A signed release of small files, and keys that are thrown away."""

import shutil
import subprocess

import pytest

from release.signing import sign


@pytest.fixture(scope="session")
def make_key(tmp_path_factory):
    """Makes a key of ssh-keygen without a passphrase."""

    if shutil.which("ssh-keygen") is None:
        pytest.skip("no ssh-keygen")

    def make(name, kind="ed25519"):
        file = tmp_path_factory.mktemp("keys") / name
        asked = ["ssh-keygen", "-q", "-t", kind, "-N", "", "-C", "", "-f", file]
        subprocess.run(asked, check=True)
        return file

    return make


@pytest.fixture(scope="session")
def key(make_key):
    return make_key("release")


@pytest.fixture
def signed(tmp_path, key):
    """A folder of signed files, and the file of allowed signers."""
    folder, work = tmp_path / "dist", tmp_path / "work"
    folder.mkdir()
    work.mkdir()
    for name, content in {
        "valvemap-9.9.9-py3-none-any.whl": bytes(range(256)) * 40,
        "valvemap-9.9.9.tar.gz": b"\x1f\x8b" + b"sdist" * 100,
        "valvemap-9.9.9-image.tar.gz": b"\0" * 5_000,
        "valvemap-9.9.9-image.cdx.json": b"{}\n",
    }.items():
        (folder / name).write_bytes(content)
    signers = tmp_path / "allowed_signers"
    signers.write_text(sign(folder, key, work) + "\n", encoding="ascii")
    return folder, signers
