"""What was signed verifies, and nothing else does."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from release import verify
from release.signing import sign
from release.verify import SIGNATURE, SUMS, faults, main

ROOT = Path(__file__).parents[2]


def test_a_release_as_it_was_signed_verifies(signed, capsys):
    folder, signers = signed
    assert main([str(folder), str(signers)]) == 0
    assert capsys.readouterr().out == f"{folder}: 4 files as signed\n"


def test_the_list_names_every_file_once_as_sha256sum_does(signed):
    folder, _ = signed
    done = subprocess.run(
        ["sha256sum", "--check", "--strict", SUMS], cwd=folder, capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr
    names = {line.split("  ")[1] for line in (folder / SUMS).read_text().splitlines()}
    assert names == {file.name for file in folder.iterdir()} - {SUMS, SIGNATURE}


def test_the_documented_commands_without_python_verify_it_too(signed):
    """The lines of docs/release.md, typed into a shell."""
    folder, signers = signed
    text = (ROOT / "docs" / "release.md").read_text(encoding="utf-8")
    (lines,) = [block for block in text.split("```") if "ssh-keygen -Y verify" in block]
    script = lines.replace("../allowed_signers", str(signers))
    shell = ["sh", "-e", "-c", script]
    assert subprocess.run(shell, cwd=folder, check=False, capture_output=True).returncode == 0
    file = folder / "valvemap-9.9.9.tar.gz"
    file.write_bytes(file.read_bytes() + b"x")
    assert subprocess.run(shell, cwd=folder, check=False, capture_output=True).returncode != 0


def test_the_script_runs_without_the_repository(signed, tmp_path):
    folder, signers = signed
    script = tmp_path / "verify.py"
    shutil.copy(verify.__file__, script)
    asked = [sys.executable, "-I", script, folder, signers]
    assert subprocess.run(asked, cwd=tmp_path, check=False, capture_output=True).returncode == 0


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("bit", [0, 7])
def test_one_flipped_bit_of_any_file_is_found(signed, share, bit):
    folder, signers = signed
    for file in sorted(folder.iterdir()):
        whole = file.read_bytes()
        place = round(share * (len(whole) - 1))
        changed = bytearray(whole)
        changed[place] ^= 1 << bit
        file.write_bytes(changed)
        found = faults(folder, signers)
        assert len(found) == 1, (file.name, place)
        assert str(folder) in found[0]
        if file.name not in {SUMS, SIGNATURE}:
            assert found == [f"{file}: changed"]
        file.write_bytes(whole)
    assert faults(folder, signers) == []


def test_every_flipped_bit_of_the_signature_is_found(signed):
    """ssh-keygen itself passes over changes of line ends and of unused bits of base64."""
    folder, signers = signed
    file = folder / SIGNATURE
    whole = file.read_bytes()
    for place in (*range(0, len(whole), 23), *range(len(whole) - 40, len(whole))):
        changed = bytearray(whole)
        changed[place] ^= 1
        file.write_bytes(changed)
        assert len(faults(folder, signers)) == 1, place


@pytest.mark.parametrize("change", [lambda whole: whole[:-1], lambda whole: whole + b"\n"])
def test_a_shorter_or_longer_file_is_found(signed, change):
    folder, signers = signed
    for file in sorted(folder.iterdir()):
        whole = file.read_bytes()
        file.write_bytes(change(whole))
        assert len(faults(folder, signers)) == 1, file.name
        file.write_bytes(whole)


def test_a_missing_file_is_named(signed):
    folder, signers = signed
    for file in sorted(folder.iterdir()):
        whole = file.read_bytes()
        file.unlink()
        (line,) = faults(folder, signers)
        assert line.startswith(f"{file}: ")
        file.write_bytes(whole)


@pytest.mark.parametrize("name", ["extra.whl", ".hidden", "sha256sums", "SHA256SUMS.sig2"])
def test_a_file_more_is_named(signed, name):
    folder, signers = signed
    (folder / name).write_bytes(b"")
    assert faults(folder, signers) == [f"{folder / name}: not listed in {SUMS}"]


def test_two_files_that_changed_names_are_found(signed):
    folder, signers = signed
    one, other = folder / "valvemap-9.9.9.tar.gz", folder / "valvemap-9.9.9-image.tar.gz"
    one.rename(folder / "aside")
    other.rename(one)
    (folder / "aside").rename(other)
    assert faults(folder, signers) == [f"{other}: changed", f"{one}: changed"]


def test_a_link_to_the_right_bytes_and_a_folder_are_no_plain_files(signed, tmp_path):
    folder, signers = signed
    file = folder / "valvemap-9.9.9.tar.gz"
    file.rename(tmp_path / "elsewhere")
    file.symlink_to(tmp_path / "elsewhere")
    assert faults(folder, signers) == [f"{file}: not a plain file"]
    file.unlink()
    (tmp_path / "elsewhere").rename(file)
    (folder / "more").mkdir()
    assert faults(folder, signers) == [f"{folder / 'more'}: not a plain file"]


def resigned(folder, key, tmp_path):
    """The folder signed by another key; what allows that key."""
    for name in (SUMS, SIGNATURE):
        (folder / name).unlink()
    work = tmp_path / "resigned"
    work.mkdir()
    return sign(folder, key, work)


@pytest.mark.parametrize("kind", ["ed25519", "rsa", "ecdsa"])
def test_another_key_is_refused_until_it_is_allowed(signed, make_key, tmp_path, kind):
    folder, signers = signed
    allowed = resigned(folder, make_key("other", kind), tmp_path)
    (line,) = faults(folder, signers)
    assert "signature refused" in line
    with signers.open("a", encoding="ascii") as more:
        more.write(allowed + "\n")
    assert faults(folder, signers) == []


def test_a_signature_made_for_another_purpose_is_refused(signed, key):
    folder, signers = signed
    signers.write_text(signers.read_text().replace('namespaces="valvemap-release" ', ""))
    (folder / SIGNATURE).unlink()
    asked = ["ssh-keygen", "-q", "-Y", "sign", "-f", key, "-n", "file", folder / SUMS]
    subprocess.run(asked, check=True, capture_output=True)
    (line,) = faults(folder, signers)
    assert "signature refused" in line


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"hello\n",
        b"0" * 64 + b"  ../outside\n",
        b"0" * 64 + b"  /etc/passwd\n",
        b"0" * 64 + b"  SHA256SUMS\n",
        b"0" * 63 + b"  short\n",
        (b"0" * 64 + b"  twice\n") * 2,
        b"0" * 64 + b"  \xff\n",
    ],
)
def test_a_signed_list_that_is_none_is_refused(signed, key, text):
    folder, signers = signed
    (folder / SIGNATURE).unlink()
    (folder / SUMS).write_bytes(text)
    asked = ["ssh-keygen", "-q", "-Y", "sign", "-f", key, "-n", verify.NAMESPACE, folder / SUMS]
    subprocess.run(asked, check=True, capture_output=True)
    assert faults(folder, signers) == [
        f"{folder / SUMS}: not a list of SHA-256 sums and file names"
    ]


@pytest.mark.parametrize("arguments", [[], ["a"], ["", ""], ["a", "b", "c"]])
def test_wrong_use_is_one_line(arguments, capsys):
    assert main(arguments) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_what_is_not_there_is_one_line(signed, tmp_path, capsys):
    folder, signers = signed
    for arguments in ([tmp_path / "no", signers], [folder, tmp_path / "no"]):
        assert main([str(argument) for argument in arguments]) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"{tmp_path / 'no'}: ")
