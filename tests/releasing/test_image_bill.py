"""The bill of an image is what its last layer leaves, packages of the system included."""

import io
import json
import tarfile

import pytest

from documentation.bill_of_materials import LOCK
from release.bill import image_bill
from release.dpkg import SystemPackage, distribution, installed
from release.errors import ReleaseError
from release.image_archive import read_image
from release.images import pack
from support.bills import complaint_of

STATUS = """\
Package: bash
Status: install ok installed
Version: 5.2.15-2+b7
Architecture: amd64
Source: bash (5.2.15-2)
Description: shell
 Version: 0 is a line of the description
 .
 more

Package: libc6
Status: install ok installed
Architecture: amd64
Source: glibc
Version: 2.36-9

Package: gone
Status: deinstall ok config-files
Architecture: amd64
Version: 1
"""
BASH = "pkg:deb/debian/bash@5.2.15-2%2Bb7?arch=amd64&distro=debian-12"
LIBC = "pkg:deb/debian/libc6@2.36-9?arch=amd64&distro=debian-12&upstream=glibc"
OS_RELEASE = '# a comment\nNAME="Debian GNU/Linux"\nID=debian\nVERSION_ID="12"\n'
SITE = "opt/valvemap/venv/lib/python3.12/site-packages"


def layer(**files):
    """A layer of files by path; None: a folder."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as archive:
        for name, content in files.items():
            entry = tarfile.TarInfo(name)
            if content is None:
                entry.type = tarfile.DIRTYPE
            data = (content or "").encode()
            entry.size = len(data)
            archive.addfile(entry, io.BytesIO(data))
    return packed.getvalue()


def image(file, *layers, environment=()):
    """An archive as `docker save` writes it."""
    names = [f"{number}/layer.tar" for number in range(len(layers))]
    manifest = [{"Config": "config.json", "RepoTags": [], "Layers": names}]
    parts = {
        "manifest.json": json.dumps(manifest).encode(),
        "config.json": json.dumps({"config": {"Env": list(environment)}}).encode(),
        **dict(zip(names, layers, strict=True)),
    }
    with tarfile.open(file, "w") as archive:
        for name, content in parts.items():
            entry = tarfile.TarInfo(name)
            entry.size = len(content)
            archive.addfile(entry, io.BytesIO(content))
    return file


def metadata(name, version, licence="MIT"):
    return f"Metadata-Version: 2.4\nName: {name}\nVersion: {version}\nLicense: {licence}\n\ntext\n"


@pytest.fixture
def archive(tmp_path):
    base = layer(
        **{
            "./var/lib/dpkg/status": STATUS,
            "etc/os-release": OS_RELEASE,
            "usr/local/lib/python3.12/site-packages/pip-24.0.dist-info/METADATA": metadata(
                "pip", "24.0"
            ),
        }
    )
    ours = layer(
        **{
            f"{SITE}/numpy-2.0.0.dist-info/METADATA": metadata("numpy", "2.0.0"),
            f"{SITE}/valvemap-9.9.9.dist-info/METADATA": metadata("valvemap", "9.9.9"),
            f"{SITE}/old-1.0.egg-info/PKG-INFO": metadata("old", "1.0"),
            "usr/local/lib/python3.12/site-packages/.wh.pip-24.0.dist-info": "",
        }
    )
    return image(tmp_path / "image.tar", base, ours, environment=["PYTHON_VERSION=3.12.5"])


def purls(bill):
    return {part["purl"] for part in json.loads(bill)["components"]}


def test_it_is_valid_and_names_what_the_image_has(archive):
    bill = image_bill(archive, [LOCK], "valvemap", "9.9.9")
    assert complaint_of(bill) is None
    found = purls(bill)
    assert {
        BASH,
        LIBC,
        "pkg:pypi/numpy@2.0.0",
        "pkg:pypi/old@1.0",
        "pkg:generic/python@3.12.5",
    } <= found
    assert "pkg:npm/uplot@1.6.32" in found
    assert not [purl for purl in found if "gone" in purl or "pip@" in purl]


def test_a_compressed_archive_has_the_same_bill_and_the_same_bytes_each_time(archive, tmp_path):
    whole, plain = archive.read_bytes(), image_bill(archive, [LOCK], "valvemap", "9")
    packed = pack(archive)
    assert not archive.exists()
    assert purls(image_bill(packed, [LOCK], "valvemap", "9")) == purls(plain)
    again = tmp_path / "again.tar"
    again.write_bytes(whole)
    assert pack(again).read_bytes() == packed.read_bytes()


def test_a_locked_package_has_its_digests(tmp_path):
    lock = tmp_path / "lock"
    lock.write_text(f"some-package==1.0 \\\n    --hash=sha256:{'ab' * 32}\n", encoding="utf-8")
    files = {"var/lib/dpkg/status": STATUS}
    files[f"{SITE}/Some_Package-1.0.dist-info/METADATA"] = metadata("Some_Package", "1.0")
    bill = image_bill(image(tmp_path / "x.tar", layer(**files)), [lock], "valvemap", "9")
    (part,) = [p for p in json.loads(bill)["components"] if p["purl"].startswith("pkg:pypi/")]
    assert part["hashes"] == [{"alg": "SHA-256", "content": "ab" * 32}]


def test_an_image_without_a_database_of_packages_has_no_bill(tmp_path):
    file = image(tmp_path / "x.tar", layer(**{"etc/os-release": OS_RELEASE}))
    with pytest.raises(ReleaseError, match="no database"):
        image_bill(file, [LOCK], "valvemap", "9")


def test_later_layers_replace_remove_and_empty_what_is_below(tmp_path):
    below = layer(**{"a/x": "old", "a/y": "y", "b/z": "z", "c": "file", "d/e/f": "f"})
    above = layer(**{"a/x": "new", "b/.wh..wh..opq": "", "c/inside": "now a folder", ".wh.d": ""})
    found = read_image(image(tmp_path / "x.tar", below, above), lambda _: True).files
    assert found == {"a/x": b"new", "a/y": b"y", "c/inside": b"now a folder"}


def test_a_link_hides_the_file_below(tmp_path):
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as archive:
        link = tarfile.TarInfo("a")
        link.type, link.linkname = tarfile.SYMTYPE, "/etc/passwd"
        archive.addfile(link)
    file = image(tmp_path / "x.tar", layer(a="old"), packed.getvalue())
    assert read_image(file, lambda _: True).files == {}


@pytest.mark.parametrize("content", [b"", b"no archive", b"\0" * 2048])
def test_what_is_no_archive_is_one_sentence(tmp_path, content):
    file = tmp_path / "x.tar"
    file.write_bytes(content)
    with pytest.raises(ReleaseError, match="not an archive of one image"):
        read_image(file, lambda _: True)


def test_packages_of_an_image_without_dpkg_have_a_file_each():
    (package,) = installed("Package: tzdata\nVersion: 2024a-0\nArchitecture: all")
    assert package == SystemPackage("tzdata", "2024a-0", "all", "tzdata")


@pytest.mark.parametrize(
    ("text", "known"),
    [(OS_RELEASE, ("debian", "12")), ("ID=alpine", ("alpine", "")), ("", ("linux", ""))],
)
def test_a_distribution_is_named_by_its_own_file(text, known):
    found = distribution(text)
    assert (found.id, found.version) == known
