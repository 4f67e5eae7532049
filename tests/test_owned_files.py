"""Files that people own are written aside and renamed: none is ever half."""

import os
import signal
import subprocess
import sys

import pytest

from valvemap import owned_files
from valvemap.errors import StorageError
from valvemap.owned_files import write_whole, written_aside


def test_what_is_written_is_there_and_nothing_beside_it(tmp_path):
    file = tmp_path / "map.csv"
    write_whole(file, "Öl")
    write_whole(file, b"\x00more")
    assert file.read_bytes() == b"\x00more"
    assert [path.name for path in tmp_path.iterdir()] == ["map.csv"]


def write_and(file, following):
    with written_aside(file) as draft:
        draft.write_text("new")
        following()


@pytest.mark.parametrize("step", ["write", "fsync", "rename"])
def test_what_fails_leaves_the_old_file_whole(tmp_path, monkeypatch, step):
    file = tmp_path / "map.csv"
    file.write_text("old")

    def full(*_):
        raise OSError(28, "No space left on device")

    if step == "fsync":
        monkeypatch.setattr(owned_files.os, "fsync", full)
    if step == "rename":
        monkeypatch.setattr(owned_files.Path, "replace", full)
    with pytest.raises(StorageError, match=r"map\.csv: no space left"):
        write_and(file, full if step == "write" else lambda: None)
    assert file.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["map.csv"]


ENDLESS = """
import sys
from pathlib import Path
from valvemap.owned_files import write_whole
k = 0
print("begun", flush=True)
while True:
    k += 1
    write_whole(Path(sys.argv[1]), f"{k}\\n" * 200_000)
"""


@pytest.mark.parametrize("after_ms", [1, 7, 23, 61])
def test_a_kill_while_writing_leaves_a_whole_file(tmp_path, after_ms):
    file = tmp_path / "map.csv"
    file.write_text("0\n" * 200_000)
    with subprocess.Popen(
        [sys.executable, "-c", ENDLESS, str(file)], stdout=subprocess.PIPE, text=True
    ) as writer:
        writer.stdout.readline()
        with pytest.raises(subprocess.TimeoutExpired):
            writer.wait(after_ms / 1e3)
        writer.send_signal(getattr(signal, "SIGKILL", signal.SIGTERM))
    lines = file.read_text().splitlines()
    assert len(lines) == 200_000
    assert len(set(lines)) == 1


@pytest.mark.skipif(os.name == "nt", reason="links and modes of POSIX")
def test_a_link_stays_a_link_and_a_mode_stays_a_mode(tmp_path):
    there, link = tmp_path / "there.csv", tmp_path / "link.csv"
    there.write_text("old")
    there.chmod(0o640)
    link.symlink_to(there)
    write_whole(link, "new")
    assert link.is_symlink()
    assert (there.read_text(), there.stat().st_mode & 0o777) == ("new", 0o640)


@pytest.mark.skipif(os.name == "nt", reason="devices of POSIX")
def test_a_device_is_written_where_it_is():
    write_whole(owned_files.Path("/dev/null"), "x" * 10)
    assert not owned_files.Path("/dev/null").is_file()


def test_an_error_names_the_file(tmp_path):
    with pytest.raises(StorageError, match=r"nowhere/map\.csv: no such file or directory"):
        write_whole(tmp_path / "nowhere" / "map.csv", "x")
