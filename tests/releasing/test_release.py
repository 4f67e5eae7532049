"""`make release`: what it refuses, what it leaves out aloud, and one made in full."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from release import __main__ as command
from release import images
from release.commands import run
from release.errors import ReleaseError
from release.packages import build_packages, export
from release.verify import faults
from support.base_image import base_image

ROOT = Path(__file__).parents[2]
DOCKERFILE = (ROOT / "Dockerfile").read_text(encoding="utf-8")


def git(folder, *words):
    asked = ["git", "-C", folder, "-c", "user.name=x", "-c", "user.email=x@localhost", *words]
    return subprocess.run(asked, check=True, capture_output=True, text=True).stdout


def committed(folder):
    git(folder, "init", "-q")
    git(folder, "add", "-A")
    git(folder, "commit", "-q", "-m", "all")
    return folder


@pytest.fixture
def clone(tmp_path):
    """The tree as it would be committed now, in a repository of its own."""
    folder = tmp_path / "clone"
    listed = git(ROOT, "ls-files", "--cached", "--others", "--exclude-standard").splitlines()
    for name in listed:
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return committed(folder)


@pytest.fixture
def small(tmp_path):
    """A repository of two files, which ignores a folder."""
    folder = tmp_path / "small"
    (folder / "deep").mkdir(parents=True)
    (folder / ".gitignore").write_text("/data/\n", encoding="utf-8")
    (folder / "deep" / "README.md").write_text("text\n", encoding="utf-8")
    return committed(folder)


def one_line(capsys, code, *arguments):
    assert command.main(list(map(str, arguments))) == code
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_a_key_is_needed_before_any_work(capsys, tmp_path):
    assert "make release KEY=FILE" in one_line(capsys, 2)
    assert "no such key" in one_line(capsys, 2, "--key", tmp_path / "none")


def test_nothing_is_ever_written_over(capsys, key, tmp_path):
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    line = one_line(capsys, 2, "--key", key, "--out", tmp_path)
    assert line.endswith("exists already; a new or empty folder is needed (DIST=FOLDER)")


def test_without_a_builder_it_stops_in_one_line_that_names_the_way_out(
    capsys, key, tmp_path, monkeypatch
):
    monkeypatch.setattr(images.shutil, "which", lambda _: None)
    line = one_line(capsys, 1, "--key", key, "--out", tmp_path / "out")
    assert "buildah, podman, docker" in line
    assert "IMAGES=no" in line
    assert not (tmp_path / "out").exists()


def test_a_builder_whose_server_is_away_is_passed_over(tmp_path, monkeypatch):
    for name, code in (("podman", 1), ("docker", 0)):
        (tmp_path / name).write_text(f"#!/bin/sh\nexit {code}\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert images.find_builder().name == "docker"
    (tmp_path / "docker").write_text("#!/bin/sh\nexit 1\n")
    assert images.find_builder() is None


def test_a_program_that_fails_is_one_line_with_its_last_words():
    words = [sys.executable, "-c", "import sys; sys.exit('first\\nlast')"]
    with pytest.raises(ReleaseError, match=r"exit code 1: last$"):
        run(words)
    with pytest.raises(ReleaseError, match="no such file"):
        run(["no-such-program"])


def test_only_what_is_committed_is_exported(small, tmp_path):
    (small / "data").mkdir()
    (small / "data" / "secret").write_text("ignored", encoding="utf-8")
    source = export(small, tmp_path / "source")
    files = {str(f.relative_to(source.folder)) for f in source.folder.rglob("*") if f.is_file()}
    assert files == set(git(small, "ls-files").splitlines())
    assert source.commit == git(small, "rev-parse", "HEAD").strip()
    stamps = {int(file.stat().st_mtime) for file in source.folder.rglob("*") if file.is_file()}
    assert stamps == {source.epoch}


@pytest.mark.parametrize("name", ["new.py", "deep/README.md"])
def test_a_tree_with_changes_is_no_release(small, tmp_path, name):
    (small / name).write_text("changed", encoding="utf-8")
    with pytest.raises(ReleaseError, match="1 files are not committed"):
        export(small, tmp_path / "source")


@pytest.mark.image
def test_wheel_and_sdist_are_the_same_bytes_at_each_build(clone, tmp_path):
    made = []
    for turn in ("one", "other"):
        source = export(clone, tmp_path / f"source-{turn}")
        out = tmp_path / turn
        build_packages(source, out, tmp_path / f"work-{turn}")
        made.append({file.name: file.read_bytes() for file in out.iterdir()})
    assert made[0] == made[1]
    assert sorted(name.partition("-")[2].partition(".")[0] for name in made[0]) == ["0", "0"]


def released(clone, key, out, *more):
    """Run the command in a clone, as `make release` does."""
    words = ["--key", key, "--out", out, *more]
    asked = [sys.executable, "-m", "release", *words]
    return subprocess.run(asked, cwd=clone, capture_output=True, text=True, check=False)


@pytest.fixture
def signers(tmp_path):
    def write(done):
        (line,) = re.findall(r"^valvemap namespaces=.*$", done.stdout, re.MULTILINE)
        file = tmp_path / "allowed_signers"
        file.write_text(line + "\n", encoding="ascii")
        return file

    return write


def check_by_one_byte(out, allowed):
    assert faults(out, allowed) == []
    for file in sorted(out.iterdir()):
        size = file.stat().st_size
        for place in {0, size // 2, size - 2}:
            with file.open("r+b") as opened:
                opened.seek(place)
                (byte,) = opened.read(1)
                opened.seek(place)
                opened.write(bytes([byte ^ 1]))
            assert len(faults(out, allowed)) == 1, (file.name, place)
            with file.open("r+b") as opened:
                opened.seek(place)
                opened.write(bytes([byte]))
    assert faults(out, allowed) == []


@pytest.mark.image
def test_a_release_without_images_says_so_and_verifies(clone, key, tmp_path, signers):
    out = tmp_path / "out"
    done = released(clone, key, out, "--images", "no")
    assert done.returncode == 0, done.stderr
    assert "images are left out" in done.stdout
    endings = sorted(file.name.partition("-")[2] or file.name for file in out.iterdir())
    assert len(endings) == 5, endings
    check_by_one_byte(out, signers(done))


@pytest.fixture
def base():
    """A base image that the builder can use."""
    builder = images.find_builder()
    if builder is None:
        pytest.skip("no image builder")
    published = re.search(r"^ARG PYTHON_IMAGE=(.+)$", DOCKERFILE, re.MULTILINE)[1]
    return base_image(published, builder.name)


@pytest.mark.image
@pytest.mark.soak
@pytest.mark.timeout(7200)
def test_a_whole_release_has_both_images_with_their_bills_and_verifies(
    clone, key, tmp_path, signers, base
):
    out = tmp_path / "out"
    done = released(clone, key, out, "--base", base)
    assert done.returncode == 0, done.stderr
    bills = sorted(out.glob("*.cdx.json"))
    assert len(bills) == 2
    for bill in bills:
        purls = {part["purl"] for part in json.loads(bill.read_text())["components"]}
        assert {"pkg:deb/debian/libc6", "pkg:deb/debian/dpkg"} <= {p.split("@")[0] for p in purls}
        assert "pkg:pypi/asyncua@2.1.0" in purls
        assert ("fleet" in bill.name) == any("pkg:pypi/quixstreams@" in purl for purl in purls)
        assert not any(purl.startswith("pkg:pypi/pytest@") for purl in purls)
    assert len(list(out.iterdir())) == 8
    check_by_one_byte(out, signers(done))
