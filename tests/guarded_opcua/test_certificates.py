import datetime as dt
import ipaddress
import stat
import sys

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID

from guarded_opcua.errors import CertificateError
from guarded_opcua.security import own_certificate
from guarded_opcua.security.certificates import expiry_warning, load_certificate, thumbprint
from guarded_opcua.security.own_certificate import ensure_certificate, make_certificate
from guarded_opcua.security.pki_folders import MAX_REJECTED, Pki, reject, rejected, trust

URI = "urn:test-host:valvemap:rig"
HOSTS = ("localhost", "rig.example", "127.0.0.1")


@pytest.fixture(scope="module")
def key():
    return rsa.generate_private_key(public_exponent=65537, key_size=2048)


@pytest.fixture(scope="module")
def other_key():
    return rsa.generate_private_key(public_exponent=65537, key_size=2048)


@pytest.fixture
def pki(tmp_path):
    return Pki(tmp_path / "pki")


@pytest.fixture
def own(pki, key, monkeypatch):
    monkeypatch.setattr(own_certificate.rsa, "generate_private_key", lambda **_: key)
    return ensure_certificate(pki, URI, HOSTS, "rig")


def der(certificate):
    return certificate.public_bytes(serialization.Encoding.DER)


def peer(key, name="peer"):
    return make_certificate(key, f"urn:{name}", ("localhost",), name)


def test_a_certificate_names_application_and_hosts_letter_by_letter(own):
    names = load_certificate(own.certificate).extensions.get_extension_for_class(
        x509.SubjectAlternativeName
    )
    assert names.value.get_values_for_type(x509.UniformResourceIdentifier) == [URI]
    assert names.value.get_values_for_type(x509.DNSName) == ["localhost", "rig.example"]
    assert names.value.get_values_for_type(x509.IPAddress) == [ipaddress.ip_address("127.0.0.1")]


def test_a_certificate_may_be_used_as_part_6_wants(own):
    extensions = load_certificate(own.certificate).extensions
    usage = extensions.get_extension_for_class(x509.KeyUsage).value
    assert usage.digital_signature
    assert usage.content_commitment
    assert usage.key_encipherment
    assert usage.data_encipherment
    extended = extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert set(extended) == {ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH}
    assert not extensions.get_extension_for_class(x509.BasicConstraints).value.ca


def test_a_key_has_2048_bits_at_least(tmp_path):
    paths = ensure_certificate(Pki(tmp_path), URI, HOSTS, "rig")
    assert load_certificate(paths.certificate).public_key().key_size >= 2048


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX modes")
def test_only_the_owner_can_read_the_key(own):
    assert stat.S_IMODE(own.key.stat().st_mode) == 0o600


def test_a_certificate_that_fits_is_kept(pki, own):
    before = own.certificate.read_bytes()
    assert ensure_certificate(pki, URI, HOSTS, "rig") == own
    assert own.certificate.read_bytes() == before


@pytest.mark.parametrize(
    ("uri", "hosts"), [("urn:other", HOSTS), (URI, (*HOSTS, "new.example")), (URI, ("::1",))]
)
def test_a_certificate_that_names_too_little_is_renewed_with_the_same_key(pki, own, uri, hosts):
    before = load_certificate(own.certificate)
    ensure_certificate(pki, uri, hosts, "rig")
    after = load_certificate(own.certificate)
    assert der(after) != der(before)
    assert after.public_key() == before.public_key()


def test_a_foreign_key_beside_a_certificate_is_an_error_that_names_both(other_key, pki, own):
    own.key.write_bytes(own_certificate._key_bytes(other_key))
    with pytest.raises(CertificateError, match=r"rig\.der: does not belong to .*rig\.pem"):
        ensure_certificate(pki, URI, HOSTS, "rig")


def test_a_damaged_key_or_certificate_is_named(pki, own):
    own.certificate.write_bytes(b"rubbish")
    with pytest.raises(CertificateError, match=r"rig\.der: not an X\.509 certificate"):
        ensure_certificate(pki, URI, HOSTS, "rig")
    own.key.write_bytes(b"rubbish")
    with pytest.raises(CertificateError, match=r"rig\.pem: not an unencrypted private key"):
        ensure_certificate(pki, URI, HOSTS, "rig")


def test_a_refused_certificate_is_trusted_by_the_beginning_of_its_thumbprint(pki, key):
    certificate = peer(key)
    reject(pki, der(certificate))
    assert [file.stem for file in rejected(pki)] == [thumbprint(certificate)]
    target = trust(pki, thumbprint(certificate)[:8].upper())
    assert load_certificate(target) == certificate
    assert rejected(pki) == ()
    assert trust(pki, thumbprint(certificate)) == target  # the same, typed again


def test_a_certificate_is_trusted_by_its_file_in_pem_form(pki, key, tmp_path):
    file = tmp_path / "peer.pem"
    file.write_bytes(peer(key).public_bytes(serialization.Encoding.PEM))
    assert load_certificate(trust(pki, file)) == load_certificate(file)
    assert file.exists()


def test_trusting_what_is_not_there_says_where_was_looked(pki):
    with pytest.raises(CertificateError, match="neither a file nor the thumbprint"):
        trust(pki, "abcdef12")


def test_refused_certificates_stay_bounded(pki):
    for number in range(MAX_REJECTED + 20):
        reject(pki, b"certificate %d" % number)
    assert len(rejected(pki)) == MAX_REJECTED


def test_expiry_is_warned_of_a_month_ahead(key):
    certificate = peer(key)
    end = certificate.not_valid_after_utc
    assert expiry_warning(certificate, end - dt.timedelta(days=31)) == ""
    assert "expires on" in expiry_warning(certificate, end - dt.timedelta(days=29))
    assert "expired on" in expiry_warning(certificate, end + dt.timedelta(days=1))
