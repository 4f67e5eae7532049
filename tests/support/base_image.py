"""A base image for our Dockerfile, where no registry of images can be reached.

It is made of Debian's packages, with the settings of pip and the certificates of this machine.
"""

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest

ASKED = os.environ.get("VALVEMAP_TEST_BASE", "")
"""Another base image than the Dockerfile's."""

_MADE = "localhost/valvemap-test-base"
_PACKAGES = "python3,python3-venv,python3-pip,python-is-python3,ca-certificates"
_DEBIAN = "http://deb.debian.org/debian"
_OF_THIS_MACHINE = "etc/pip.conf", "etc/ssl/certs/ca-certificates.crt"


def base_image(published, builder):
    """Return a base image for a program that builds: the one asked for, the published, or ours."""
    if ASKED:
        return ASKED
    if not _call(builder, "pull", published).returncode:
        return published
    if builder != "buildah" or shutil.which("debootstrap") is None or os.geteuid():
        pytest.skip(f"{published} cannot be reached; VALVEMAP_TEST_BASE may name another")
    if _call("buildah", "inspect", "--type", "image", _MADE).returncode:
        _make()
    return _MADE


def _make():
    with tempfile.TemporaryDirectory() as folder:
        words = "--variant=minbase", f"--include={_PACKAGES}", "bookworm", folder, _DEBIAN
        done = _call("debootstrap", *words)
        if done.returncode:
            pytest.skip(f"debootstrap: {done.stdout.strip()[-200:]}")
        for name in _OF_THIS_MACHINE:
            if Path("/", name).exists():
                shutil.copy(Path("/", name), Path(folder, name))
        container = _call("buildah", "from", "scratch").stdout.strip()
        for step in (("copy", container, folder, "/"), ("commit", "--rm", container, _MADE)):
            made = _call("buildah", *step)
            assert made.returncode == 0, made.stderr


def _call(*words):
    return subprocess.run(words, capture_output=True, text=True, check=False)
