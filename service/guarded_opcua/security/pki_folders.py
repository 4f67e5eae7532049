"""The folders of certificates: which peers are trusted, and which were refused (Part 12, 7)."""

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from cryptography.hazmat.primitives import serialization

from guarded_opcua.errors import CertificateError
from guarded_opcua.logs import bounded_logger
from guarded_opcua.security.certificates import fingerprint, load_certificate, thumbprint
from guarded_opcua.security.whole_files import write_readable

_log = bounded_logger(__name__)

MAX_REJECTED = 100
LEAST_DIGITS = 6  # of a thumbprint that is typed
CERTIFICATE_SUFFIXES = {".der", ".cer", ".crt", ".pem"}


@dataclass(frozen=True)
class Pki:
    """Folders of certificates: ``own``, ``trusted``, ``issuers`` and ``rejected``.

    ``trusted`` holds the certificates (DER or PEM) of trusted peers, and of authorities whose peers
    are trusted. ``issuers`` holds those of authorities that only complete a chain. Revocation lists
    (``.crl``) may be stored in either. Certificates of unknown peers are stored in ``rejected``.
    """

    folder: Path

    @property
    def own(self) -> Path:
        """Certificates and keys of this application."""
        return self.folder / "own"

    @property
    def trusted(self) -> Path:
        """Trusted certificates."""
        return self.folder / "trusted"

    @property
    def issuers(self) -> Path:
        """Certificates of authorities that complete a chain but are not trusted."""
        return self.folder / "issuers"

    @property
    def rejected(self) -> Path:
        """Certificates of refused peers."""
        return self.folder / "rejected"

    def make_folders(self) -> None:
        """Create missing folders.

        Raises
        ------
        CertificateError
            if a folder cannot be created.
        """
        try:
            for folder in (self.own, self.trusted, self.issuers, self.rejected):
                folder.mkdir(parents=True, exist_ok=True)
            self.own.chmod(0o700)
        except OSError as error:
            raise CertificateError(f"{self.folder}: cannot be made: {error.strerror}") from error


def rejected(pki: Pki) -> tuple[Path, ...]:
    """Return the refused certificates, the newest first."""
    files = files_with(pki.rejected, CERTIFICATE_SUFFIXES)
    return tuple(sorted(files, key=lambda file: file.stat().st_mtime, reverse=True))


def trust(pki: Pki, thumbprint_or_file: str | Path) -> Path:
    """Trust a refused peer by (a prefix of) its thumbprint, or any peer by its certificate file.

    One that is trusted already remains so.

    Returns
    -------
    Path
        The file in ``trusted``.

    Raises
    ------
    CertificateError
        if no certificate or more than one matches, or the file is not a certificate.
    """
    pki.make_folders()
    source = Path(thumbprint_or_file)
    if not source.is_file():
        source = _by_thumbprint(pki, str(thumbprint_or_file))
        if source.parent == pki.trusted:
            return source
    certificate = load_certificate(source)
    target = pki.trusted / f"{thumbprint(certificate)}.der"
    try:
        write_readable(target, certificate.public_bytes(serialization.Encoding.DER))
        if source.parent == pki.rejected:
            source.unlink()
    except OSError as error:
        raise CertificateError(f"{error.filename}: cannot be written: {error.strerror}") from error
    return target


def reject(pki: Pki, certificate: bytes) -> Path | None:
    """Store an unknown peer's certificate; at most ``MAX_REJECTED`` are kept.

    Returns
    -------
    Path or None
        The file; None if it could not be written.
    """
    target = pki.rejected / f"{thumbprint(certificate)}.der"
    try:
        if not target.exists():
            pki.rejected.mkdir(parents=True, exist_ok=True)
            for old in rejected(pki)[MAX_REJECTED - 1 :]:
                old.unlink(missing_ok=True)
            write_readable(target, certificate)
    except OSError as error:
        _log.warning("%s: cannot be kept: %s", target, error.strerror)
        return None
    return target


def files_with(folder: Path, suffixes: Collection[str]) -> list[Path]:
    """Return the files in a folder with one of the suffixes, sorted by name.

    Raises
    ------
    OSError
    """
    if not folder.is_dir():
        return []
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in suffixes)


def _by_thumbprint(pki: Pki, text: str) -> Path:
    """Return the refused certificate that it fits, or the one that is trusted already."""
    wanted = text.lower().replace(":", "").replace(" ", "")
    known = files_with(pki.trusted, CERTIFICATE_SUFFIXES)
    for files in (rejected(pki), known) if len(wanted) >= LEAST_DIGITS else ():
        fitting = [file for file in files if _has_thumbprint(file, wanted)]
        if len(fitting) == 1:
            return fitting[0]
        if fitting:
            raise CertificateError(f"{text}: fits {len(fitting)} certificates; give more of it")
    raise CertificateError(
        f"{text}: neither a file nor the thumbprint ({LEAST_DIGITS} digits or more) of a "
        f"certificate in {pki.rejected}"
    )


def _has_thumbprint(file: Path, beginning: str) -> bool:
    try:
        certificate = load_certificate(file)
    except CertificateError:
        return False
    return any(f(certificate).startswith(beginning) for f in (thumbprint, fingerprint))
