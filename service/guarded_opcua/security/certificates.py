"""Application certificates and the trust folders (OPC UA Part 6, 6.2.2; Part 12, 7)."""

import datetime as dt
import hashlib
import ipaddress
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from guarded_opcua.errors import CertificateError
from guarded_opcua.logs import bounded_logger, escaped
from guarded_opcua.security.whole_files import write_owner_only, write_readable

_log = bounded_logger(__name__)

KEY_BITS = 2048
VALID_DAYS = 730
WARN_DAYS = 30
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


@dataclass(frozen=True)
class OwnCertificate:
    """Files of an application's certificate (DER) and private key (PEM, readable by its owner)."""

    certificate: Path
    key: Path


def ensure_certificate(
    pki: Pki, application_uri: str, host_names: tuple[str, ...], name: str
) -> OwnCertificate:
    """Return this application's certificate, creating or renewing it if needed.

    A self-signed certificate is renewed (with the same key) if it has expired or does not name the
    application or all of the hosts. A certificate signed by an authority is never changed.

    Parameters
    ----------
    pki
        Folders; created if missing.
    application_uri
        Copied to the SubjectAlternativeName unchanged.
    host_names
        DNS names and IP addresses of the server.
    name
        Name of the application, and of its files in ``own``.

    Raises
    ------
    CertificateError
        if a file cannot be read or written, certificate and key do not match, or an authority's
        certificate is unsuitable.
    """
    pki.make_folders()
    paths = OwnCertificate(pki.own / f"{name}.der", pki.own / f"{name}.pem")
    key = _load_key(paths.key) if paths.key.exists() else None
    if key is not None and paths.certificate.exists():
        certificate = load_certificate(paths.certificate)
        if certificate.public_key() != key.public_key():
            raise CertificateError(f"{paths.certificate}: does not belong to {paths.key}")
        fault = _fault(certificate, application_uri, host_names)
        if fault is None:
            return paths
        if certificate.issuer != certificate.subject:
            raise CertificateError(f"{paths.certificate}: {fault}; ask its issuer for a new one")
        _log.warning("%s: %s; a new one is made, peers must trust it", paths.certificate, fault)
    try:
        if key is None:
            key = rsa.generate_private_key(public_exponent=65537, key_size=KEY_BITS)
            write_owner_only(paths.key, _key_bytes(key))
        certificate = make_certificate(key, application_uri, host_names, name)
        write_readable(paths.certificate, certificate.public_bytes(serialization.Encoding.DER))
    except OSError as error:
        raise CertificateError(f"{error.filename}: cannot be written: {error.strerror}") from error
    return paths


def make_certificate(
    key: rsa.RSAPrivateKey, application_uri: str, host_names: tuple[str, ...], name: str
) -> x509.Certificate:
    """Create a self-signed application certificate as specified in OPC UA Part 6, 6.2.2."""
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name[:64])])
    now = dt.datetime.now(dt.UTC).replace(microsecond=0)
    names: list[x509.GeneralName] = [x509.UniformResourceIdentifier(application_uri)]
    names += [_general_name(host) for host in dict.fromkeys(host_names)]
    identifier = x509.SubjectKeyIdentifier.from_public_key(key.public_key())
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - dt.timedelta(hours=1))
        .not_valid_after(now + dt.timedelta(days=VALID_DAYS))
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(
            x509.KeyUsage(
                digital_signature=True,
                content_commitment=True,
                key_encipherment=True,
                data_encipherment=True,
                key_cert_sign=True,
                key_agreement=False,
                crl_sign=False,
                encipher_only=False,
                decipher_only=False,
            ),
            critical=True,
        )
        .add_extension(
            x509.ExtendedKeyUsage(
                [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
            ),
            critical=False,
        )
        .add_extension(identifier, critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_subject_key_identifier(identifier),
            critical=False,
        )
        .sign(key, hashes.SHA256())
    )


def thumbprint(certificate: x509.Certificate | bytes) -> str:
    """Return the SHA-1 of the DER form in hex, OPC UA's name of a certificate; not for security."""
    return hashlib.sha1(_der(certificate), usedforsecurity=False).hexdigest()


def fingerprint(certificate: x509.Certificate | bytes) -> str:
    """Return the SHA-256 of the DER form in hex, which identifies the certificate securely."""
    return hashlib.sha256(_der(certificate)).hexdigest()


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


def expiry_warning(certificate: x509.Certificate, now: dt.datetime | None = None) -> str:
    """Return a warning if a certificate expires within 30 days, else ''."""
    left = certificate.not_valid_after_utc - (now or dt.datetime.now(dt.UTC))
    if left >= dt.timedelta(days=WARN_DAYS):
        return ""
    name = escaped(certificate.subject.rfc4514_string())
    if left < dt.timedelta(0):
        return f"the certificate {name} expired on {certificate.not_valid_after_utc:%Y-%m-%d}"
    return f"the certificate {name} expires on {certificate.not_valid_after_utc:%Y-%m-%d}"


def files_with(folder: Path, suffixes: Collection[str]) -> list[Path]:
    """Return the files in a folder with one of the suffixes, sorted by name.

    Raises
    ------
    OSError
    """
    if not folder.is_dir():
        return []
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in suffixes)


def load_certificate(file: Path) -> x509.Certificate:
    """Read a certificate in DER or PEM form.

    Raises
    ------
    CertificateError
        if the file cannot be read or is not a certificate.
    """
    try:
        content = file.read_bytes()
        if content.startswith(b"-----BEGIN"):
            return x509.load_pem_x509_certificate(content)
        return x509.load_der_x509_certificate(content)
    except OSError as error:
        raise CertificateError(f"{file}: cannot be read: {error.strerror}") from error
    except (ValueError, x509.InvalidVersion) as error:
        raise CertificateError(f"{file}: not an X.509 certificate (DER or PEM)") from error


def _der(certificate: x509.Certificate | bytes) -> bytes:
    if isinstance(certificate, x509.Certificate):
        return certificate.public_bytes(serialization.Encoding.DER)
    return certificate


def _load_key(file: Path) -> rsa.RSAPrivateKey:
    try:
        key = serialization.load_pem_private_key(file.read_bytes(), password=None)
    except OSError as error:
        raise CertificateError(f"{file}: cannot be read: {error.strerror}") from error
    except (ValueError, TypeError) as error:
        raise CertificateError(f"{file}: not an unencrypted private key in PEM form") from error
    if not isinstance(key, rsa.RSAPrivateKey) or key.key_size < KEY_BITS:
        raise CertificateError(f"{file}: an RSA key of at least {KEY_BITS} bits is needed")
    return key


def _key_bytes(key: rsa.RSAPrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )


def _fault(
    certificate: x509.Certificate, application_uri: str, host_names: tuple[str, ...]
) -> str | None:
    if certificate.not_valid_after_utc <= dt.datetime.now(dt.UTC):
        return f"it expired on {certificate.not_valid_after_utc:%Y-%m-%d}"
    try:
        extension = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName)
    except x509.ExtensionNotFound:
        return "it has no SubjectAlternativeName"
    names = extension.value
    if application_uri not in names.get_values_for_type(x509.UniformResourceIdentifier):
        return f"it does not name the application {application_uri}"
    missing = [host for host in host_names if _general_name(host) not in list(names)]
    return f"it does not name the host {missing[0]}" if missing else None


def _general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host.strip("[]")))
    except ValueError:
        return x509.DNSName(host)


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
