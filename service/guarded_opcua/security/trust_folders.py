"""The trust folders, reloaded when a file in them has changed."""

from collections.abc import Iterable, Iterator
from pathlib import Path

from cryptography import x509

from guarded_opcua.clock import SystemClock
from guarded_opcua.errors import CertificateError
from guarded_opcua.logs import bounded_logger
from guarded_opcua.security.certificate_paths import TrustLists
from guarded_opcua.security.certificate_rules import UNREADABLE, read_through
from guarded_opcua.security.certificates import load_certificate
from guarded_opcua.security.pki_folders import CERTIFICATE_SUFFIXES, Pki, files_with
from guarded_opcua.security.revocation import RevocationList

_log = bounded_logger(__name__)
_REVOCATION_SUFFIXES = {".crl"}
_SAME_TICK_NS = 2_000_000_000  # ns; coarsest resolution of file times (FAT: 2 s)

Stamp = tuple[tuple[str, int, int, int, int], ...]


class TrustFolders:
    """Reads ``trusted`` and ``issuers`` of a :class:`Pki`."""

    def __init__(self, pki: Pki) -> None:
        self._folders = (pki.trusted, pki.issuers)
        self._stamp: Stamp | None = None
        self._lists = TrustLists()

    def lists(self) -> TrustLists:
        """Return the current contents of the folders; the same object while they do not change."""
        stamp = self.stamp()
        if stamp != self._stamp:
            read_at = SystemClock().now()  # the system clock, as it is compared with file times
            trusted, issuers = (_files(folder) for folder in self._folders)
            revocations, unreadable = _revocations([*trusted, *issuers])
            self._lists = TrustLists(
                frozenset(_certificates(trusted)),
                tuple(_certificates(issuers)),
                revocations,
                unreadable,
            )
            newest = max((max(entry[1:3]) for entry in stamp), default=0)
            self._stamp = stamp if newest < read_at - _SAME_TICK_NS else None
        return self._lists

    def stamp(self) -> Stamp:
        """Return the file metadata of the folders, which changes whenever a file does."""
        found = []
        for file in (file for folder in self._folders for file in _files(folder)):
            try:
                held = file.stat()
            except OSError:
                continue  # deleted since the listing
            times = (held.st_mtime_ns, held.st_ctime_ns)
            found.append((str(file), *times, held.st_size, held.st_ino))
        return tuple(found)


def _files(folder: Path) -> list[Path]:
    try:
        return files_with(folder, CERTIFICATE_SUFFIXES | _REVOCATION_SUFFIXES)
    except OSError as error:
        _log.warning("%s: cannot be read: %s", folder, error.strerror)
        return []


def _certificates(files: Iterable[Path]) -> Iterator[x509.Certificate]:
    for file in files:
        if _is_revocation_list(file):
            continue
        try:
            certificate = load_certificate(file)
            read_through(certificate)
        except CertificateError as error:
            _log.warning("%s", error)
        except UNREADABLE as error:
            _log.warning("%s: cannot be understood: %s", file, error)
        else:
            yield certificate


def _revocations(files: Iterable[Path]) -> tuple[tuple[RevocationList, ...], tuple[str, ...]]:
    found, unreadable = [], []
    for file in filter(_is_revocation_list, files):
        try:
            content = file.read_bytes()
            is_pem = content.startswith(b"-----BEGIN")
            held = (x509.load_pem_x509_crl if is_pem else x509.load_der_x509_crl)(content)
            held.extensions  # noqa: B018 - parsed lazily: detect malformed extensions now
        except OSError as error:
            unreadable.append(f"{file}: cannot be read: {error.strerror}")
        except UNREADABLE as error:
            unreadable.append(f"{file}: no revocation list: {error}")
        else:
            found.append(RevocationList(file, held))
    return tuple(found), tuple(unreadable)


def _is_revocation_list(file: Path) -> bool:
    return file.suffix.lower() in _REVOCATION_SUFFIXES
