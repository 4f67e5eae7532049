"""Certificates and revocation lists, right and wrong, from a pool of keys."""

import datetime as dt
import functools
import ipaddress
import itertools
from dataclasses import dataclass

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import padding, rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID, ObjectIdentifier

URI = "urn:test:peer"
NOW = dt.datetime.now(dt.UTC).replace(microsecond=0)
DAY = dt.timedelta(days=1)
DER, PEM = serialization.Encoding.DER, serialization.Encoding.PEM
EMAIL = ExtendedKeyUsageOID.EMAIL_PROTECTION
BOTH = (ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH)
SIGN = ("digital_signature", "content_commitment", "key_encipherment", "data_encipherment")
CERTIFY = ("key_cert_sign", "crl_sign")
UNKNOWN = x509.UnrecognizedExtension(ObjectIdentifier("1.2.3.4.5"), b"\x05\x00")
_USAGES = (*SIGN, "key_agreement", *CERTIFY, "encipher_only", "decipher_only")
_SHA256 = bytes.fromhex("06092a864886f70d01010b")  # the object identifier, in DER
_WEAK = {
    "sha1": (b"\x05", hashes.SHA1()),  # noqa: S303 - must be refused
    "md5": (b"\x04", hashes.MD5()),  # noqa: S303 - must be refused
}
_serials = itertools.count(1_000)


@functools.cache
def key(number, bits=2048):
    """The key of that number; made once, it takes a while."""
    return rsa.generate_private_key(public_exponent=65537, key_size=bits)


def name(text):
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


def der(certificate):
    return certificate.public_bytes(DER)


def usage(*allowed):
    return x509.KeyUsage(**{use: use in allowed for use in _USAGES})


@dataclass(frozen=True)
class Identity:
    """A certificate and the key that belongs to it."""

    certificate: x509.Certificate
    key: rsa.RSAPrivateKey

    @property
    def der(self):
        return der(self.certificate)

    @property
    def subject(self):
        return self.certificate.subject

    def keep(self, folder, file=None):
        """Lay the certificate into a folder."""
        target = folder / (file or f"{self.certificate.serial_number}.der")
        target.write_bytes(self.der)
        return target

    def issue(self, subject="peer", number=1, **wishes):
        return make(subject, key(number), issuer=self, **wishes)

    def authority(self, subject="intermediate", number=3, **wishes):
        return make_authority(subject, key(number), issuer=self, **wishes)

    def crl(self, *revoked, **wishes):
        return make_crl(self, revoked, **wishes)

    def keep_crl(self, folder, *revoked, file=None, **wishes):
        content = self.crl(*revoked, **wishes).public_bytes(DER)
        target = folder / (file or f"{self.certificate.serial_number}.crl")
        target.write_bytes(content)
        return target


def self_signed(subject="peer", number=1, **wishes):
    """An application's certificate as it makes one for itself."""
    return make(subject, key(number), **wishes)


def root(subject="authority", number=2, **wishes):
    return make_authority(subject, key(number), **wishes)


def make_authority(subject, own_key, *, path_length=None, **wishes):
    wishes = {"ca": True, "uses": CERTIFY, "extended": None, "alternative": None, **wishes}
    return make(subject, own_key, path_length=path_length, **wishes)


def make(
    subject,
    own_key,
    *,
    issuer=None,
    issuer_name=None,
    ca=False,
    path_length=None,
    uses=SIGN,
    extended=BOTH,
    days=(-1, 30),
    uri=URI,
    hosts=("localhost", "127.0.0.1"),
    alternative=True,
    extra=(),
    critical=False,
    weak=None,
    points=None,
):
    """Make a certificate; every wish is one thing that may be wrong with it."""
    signer = issuer.key if issuer else own_key
    subject = subject if isinstance(subject, x509.Name) else name(subject)
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer_name or (issuer.subject if issuer else subject))
        .public_key(own_key.public_key())
        .serial_number(next(_serials))
        .not_valid_before(NOW + days[0] * DAY)
        .not_valid_after(NOW + days[1] * DAY)
    )
    if ca is not None:
        constraints = x509.BasicConstraints(ca=ca, path_length=path_length)
        builder = builder.add_extension(constraints, critical=True)
    if uses is not None:
        builder = builder.add_extension(usage(*uses), critical=True)
    if extended is not None:
        builder = builder.add_extension(x509.ExtendedKeyUsage(extended), critical=False)
    if alternative:
        names = [x509.UniformResourceIdentifier(uri), *map(host_name, hosts)]
        builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
    if points is not None:
        builder = builder.add_extension(x509.CRLDistributionPoints(points), critical=False)
    for more in extra:
        builder = builder.add_extension(more, critical=critical)
    certificate = builder.sign(signer, hashes.SHA256())
    if weak is not None:
        certificate = weakened(certificate, signer, weak)
    return Identity(certificate, own_key)


def make_crl(issuer, revoked=(), *, signer=None, days=(-1, 30), extra=(), critical=True):
    """Make a revocation list; ``revoked`` are identities or revoked certificates."""
    builder = (
        x509.CertificateRevocationListBuilder()
        .issuer_name(issuer.subject)
        .last_update(NOW + days[0] * DAY)
        .next_update(NOW + days[1] * DAY)
    )
    for entry in revoked:
        builder = builder.add_revoked_certificate(
            revocation(entry) if isinstance(entry, Identity) else entry
        )
    for more in extra:
        builder = builder.add_extension(more, critical=critical)
    return builder.sign((signer or issuer).key, hashes.SHA256())


def revocation(identity, reason=None):
    builder = (
        x509.RevokedCertificateBuilder()
        .serial_number(identity.certificate.serial_number)
        .revocation_date(NOW - DAY)
    )
    if reason is not None:
        builder = builder.add_extension(x509.CRLReason(reason), critical=False)
    return builder.build()


def weakened(certificate, signer, algorithm):
    """The same certificate, signed anew with a hash that is broken."""
    last, hash_ = _WEAK[algorithm]
    tbs = certificate.tbs_certificate_bytes.replace(_SHA256, _SHA256[:-1] + last)
    signature = signer.sign(tbs, padding.PKCS1v15(), hash_)
    named = b"\x30\x0d" + _SHA256[:-1] + last + b"\x05\x00"
    body = tbs + named + b"\x03" + _length(len(signature) + 1) + b"\x00" + signature
    return x509.load_der_x509_certificate(b"\x30" + _length(len(body)) + body)


def host_name(host):
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _length(size):
    content = size.to_bytes((size.bit_length() + 7) // 8, "big")
    return content if size < 0x80 else bytes([0x80 | len(content)]) + content
