import datetime as dt

import pytest
from asyncua import ua
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.x509.oid import NameOID

from service.hardened.security.certificates import Pki, make_certificate, rejected
from service.hardened.security.peer_certificates import CertificateRefused, check_peer

Codes = ua.StatusCodes
NOW = dt.datetime.now(dt.UTC)
DAY = dt.timedelta(days=1)
URI = "urn:test:peer"


@pytest.fixture(scope="module")
def keys():
    return [rsa.generate_private_key(public_exponent=65537, key_size=2048) for _ in range(2)]


@pytest.fixture
def pki(tmp_path):
    made = Pki(tmp_path)
    made.make_folders()
    return made


def der(certificate):
    return certificate.public_bytes(serialization.Encoding.DER)


def name(text):
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


def issued(
    key, issuer_key, *, subject="peer", issuer="authority", ca=False, days=(-1, 30), usage=True
):
    builder = (
        x509.CertificateBuilder()
        .subject_name(name(subject))
        .issuer_name(name(issuer))
        .public_key(key.public_key())
        .serial_number(77)
        .not_valid_before(NOW + days[0] * DAY)
        .not_valid_after(NOW + days[1] * DAY)
        .add_extension(x509.BasicConstraints(ca=ca, path_length=None), critical=True)
        .add_extension(
            x509.SubjectAlternativeName([x509.UniformResourceIdentifier(URI)]), critical=False
        )
        .add_extension(
            x509.KeyUsage(
                digital_signature=usage,
                content_commitment=usage,
                key_encipherment=usage,
                data_encipherment=usage,
                key_agreement=False,
                key_cert_sign=ca,
                crl_sign=ca,
                encipher_only=False,
                decipher_only=False,
            ),
            critical=True,
        )
    )
    return builder.sign(issuer_key, hashes.SHA256())


def keep(folder, certificate, file="one.der"):
    (folder / file).write_bytes(der(certificate))


def code_of(pki, shown, uri=None):
    try:
        check_peer(pki, shown, uri)
    except CertificateRefused as refused:
        return refused.code
    return Codes.Good


def test_a_trusted_certificate_is_accepted_and_must_name_its_application(pki, keys):
    certificate = make_certificate(keys[0], URI, ("localhost",), "peer")
    keep(pki.trusted, certificate)
    assert code_of(pki, der(certificate)) == Codes.Good
    assert code_of(pki, der(certificate), URI) == Codes.Good
    assert code_of(pki, der(certificate), "urn:other") == Codes.BadCertificateUriInvalid


def test_an_unknown_certificate_is_refused_and_kept(pki, keys):
    certificate = make_certificate(keys[0], URI, ("localhost",), "peer")
    assert code_of(pki, der(certificate)) == Codes.BadCertificateUntrusted
    (kept,) = rejected(pki)
    assert kept.read_bytes() == der(certificate)


def test_a_certificate_of_a_trusted_authority_is_accepted(pki, keys):
    authority = issued(keys[1], keys[1], subject="authority", ca=True)
    keep(pki.trusted, authority)
    assert code_of(pki, der(issued(keys[0], keys[1]))) == Codes.Good


def test_an_authority_that_is_only_an_issuer_is_not_trusted(pki, keys):
    authority = issued(keys[1], keys[1], subject="authority", ca=True)
    keep(pki.issuers, authority)
    certificate = issued(keys[0], keys[1])
    assert code_of(pki, der(certificate)) == Codes.BadCertificateUntrusted
    keep(pki.trusted, certificate)
    assert code_of(pki, der(certificate)) == Codes.Good


def test_an_authority_that_the_peer_sends_along_is_not_trusted_for_that(pki, keys):
    authority = issued(keys[1], keys[1], subject="authority", ca=True)
    shown = der(issued(keys[0], keys[1])) + der(authority)
    assert code_of(pki, shown) == Codes.BadCertificateUntrusted
    keep(pki.trusted, authority)
    assert code_of(pki, shown) == Codes.Good


def test_a_name_alone_makes_nobody_an_issuer(pki, keys):
    keep(pki.trusted, issued(keys[1], keys[1], subject="authority", ca=True))
    forged = issued(keys[0], keys[0])
    assert code_of(pki, der(forged)) == Codes.BadCertificateUntrusted


def test_who_is_no_authority_issues_nothing(pki, keys):
    keep(pki.trusted, issued(keys[1], keys[1], subject="authority", ca=False))
    assert code_of(pki, der(issued(keys[0], keys[1]))) == Codes.BadCertificateUntrusted


@pytest.mark.parametrize("days", [(-30, -1), (2, 30)])
def test_a_certificate_is_good_in_its_time_only(pki, keys, days):
    certificate = issued(keys[0], keys[0], issuer="peer", days=days)
    keep(pki.trusted, certificate)
    assert code_of(pki, der(certificate)) == Codes.BadCertificateTimeInvalid


def test_an_authority_is_good_in_its_time_only(pki, keys):
    keep(pki.trusted, issued(keys[1], keys[1], subject="authority", ca=True, days=(-30, -1)))
    assert code_of(pki, der(issued(keys[0], keys[1]))) == Codes.BadCertificateIssuerTimeInvalid


def test_a_revoked_certificate_is_refused(pki, keys):
    keep(pki.trusted, issued(keys[1], keys[1], subject="authority", ca=True))
    revoked = (
        x509.CertificateRevocationListBuilder()
        .issuer_name(name("authority"))
        .last_update(NOW - DAY)
        .next_update(NOW + DAY)
        .add_revoked_certificate(
            x509.RevokedCertificateBuilder().serial_number(77).revocation_date(NOW).build()
        )
        .sign(keys[1], hashes.SHA256())
    )
    (pki.issuers / "authority.crl").write_bytes(revoked.public_bytes(serialization.Encoding.PEM))
    certificate = der(issued(keys[0], keys[1]))
    assert code_of(pki, certificate) == Codes.BadCertificateRevoked
    (pki.issuers / "authority.crl").write_bytes(b"rubbish")
    assert code_of(pki, certificate) == Codes.BadCertificateRevocationUnknown


def test_a_key_that_may_not_be_used_or_is_too_short_is_refused(pki, keys):
    idle = issued(keys[0], keys[0], issuer="peer", usage=False)
    assert code_of(pki, der(idle)) == Codes.BadCertificateUseNotAllowed
    short = rsa.generate_private_key(public_exponent=65537, key_size=1024)  # noqa: S505 - it must be refused
    weak = issued(short, short, issuer="peer")
    assert code_of(pki, der(weak)) == Codes.BadCertificatePolicyCheckFailed
    curve = ec.generate_private_key(ec.SECP256R1())
    other = issued(curve, curve, issuer="peer")
    assert code_of(pki, der(other)) == Codes.BadCertificatePolicyCheckFailed


@pytest.mark.parametrize("shown", [b"", b"x", b"\x30\x82", b"\x30\x03abc", bytes(20_000)])
def test_what_is_no_certificate_is_refused(pki, shown):
    assert code_of(pki, shown) == Codes.BadCertificateInvalid


def test_a_damaged_file_among_the_trusted_ones_harms_nobody_else(pki, keys):
    certificate = make_certificate(keys[0], URI, ("localhost",), "peer")
    keep(pki.trusted, certificate)
    (pki.trusted / "broken.der").write_bytes(b"rubbish")
    assert code_of(pki, der(certificate)) == Codes.Good
