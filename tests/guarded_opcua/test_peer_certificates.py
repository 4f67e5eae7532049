"""Whom we trust, case by case; ``test_certificates_on_the_wire`` has the same cases again."""

import datetime as dt
import os

import pytest
from asyncua import ua
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from guarded_opcua.clock import ManualClock
from guarded_opcua.security.certificates import fingerprint
from guarded_opcua.security.peer_certificates import (
    CertificateRefused,
    PeerTrust,
    Use,
    check_host_name,
)
from guarded_opcua.security.pki_folders import Pki, rejected
from support import certificate_cases as cases
from support.certificates import (
    DAY,
    EMAIL,
    NOW,
    PEM,
    URI,
    name,
    root,
    self_signed,
)

Codes = ua.StatusCodes
START = int(NOW.timestamp() * 1e9)


@pytest.fixture
def pki(tmp_path):
    made = Pki(tmp_path)
    made.make_folders()
    return made


def code_of(pki, identity, chain=(), *, use=Use.CLIENT, uri=None, trust=None, **settings):
    return refusal(pki, identity, chain, use=use, uri=uri, trust=trust, **settings)[0]


def refusal(pki, identity, chain=(), *, use=Use.CLIENT, uri=None, trust=None, **settings):
    """Status code and sentence."""
    shown = identity if isinstance(identity, bytes) else b"".join(i.der for i in (identity, *chain))
    try:
        (trust or PeerTrust(pki, **settings)).check(shown, use, uri)
    except CertificateRefused as refused:
        return refused.code, str(refused)
    return Codes.Good, ""


@pytest.mark.parametrize("use", [Use.CLIENT, Use.SERVER])
@pytest.mark.parametrize(
    ("case", "code"), cases.REFUSED.items(), ids=[case.__name__ for case in cases.REFUSED]
)
def test_refused_is(pki, case, code, use):
    identity, chain = cases.shown(case, pki)
    assert code_of(pki, identity, chain, use=use) == code


@pytest.mark.parametrize("use", [Use.CLIENT, Use.SERVER])
@pytest.mark.parametrize("case", cases.ACCEPTED, ids=lambda c: c.__name__)
def test_accepted_is(pki, case, use):
    identity, chain = cases.shown(case, pki)
    assert refusal(pki, identity, chain, use=use) == (Codes.Good, "")


def test_a_certificate_must_name_its_application(pki):
    identity = cases.trusted_itself(pki)
    assert code_of(pki, identity, uri=URI) == Codes.Good
    assert code_of(pki, identity, uri="urn:other") == Codes.BadCertificateUriInvalid


def test_an_unknown_certificate_is_kept_without_what_was_sent_along(pki):
    authority = root()
    peer = authority.issue()
    assert code_of(pki, peer, [authority]) == Codes.BadCertificateUntrusted
    (kept,) = rejected(pki)
    assert kept.read_bytes() == peer.der


@pytest.mark.parametrize(
    ("extended", "right", "wrong"),
    [
        (ExtendedKeyUsageOID.CLIENT_AUTH, Use.CLIENT, Use.SERVER),
        (ExtendedKeyUsageOID.SERVER_AUTH, Use.SERVER, Use.CLIENT),
    ],
)
def test_a_client_is_no_server_and_the_other_way_round(pki, extended, right, wrong):
    identity = cases.trusted_itself(pki, extended=[extended])
    assert code_of(pki, identity, use=right) == Codes.Good
    assert code_of(pki, identity, use=wrong) == Codes.BadCertificateUseNotAllowed


@pytest.mark.parametrize(
    "case",
    [
        cases.one_without_a_revocation_list,
        cases.one_below_an_intermediate_without_a_revocation_list,
        cases.one_whose_revocation_list_has_expired,
        cases.one_whose_revocation_list_another_signed,
        cases.one_with_an_indirect_revocation_list,
    ],
    ids=lambda c: c.__name__,
)
def test_a_refusal_for_want_of_a_revocation_list_names_the_setting_that_allows_it(pki, case):
    identity, chain = cases.shown(case, pki)
    _, sentence = refusal(pki, identity, chain)
    assert "security.require_crl = false" in sentence
    assert code_of(pki, identity, chain, require_crl=False) == Codes.Good


@pytest.mark.parametrize(
    ("case", "code"),
    [
        (cases.a_revoked_one, Codes.BadCertificateRevoked),
        (cases.one_that_a_delta_revokes, Codes.BadCertificateRevoked),
        (cases.one_that_an_expired_list_revokes, Codes.BadCertificateRevoked),
        (cases.one_whose_revocation_list_cannot_be_read, Codes.BadCertificateRevocationUnknown),
        (cases.one_whose_issuer_is_missing, Codes.BadCertificateChainIncomplete),
    ],
    ids=lambda c: getattr(c, "__name__", ""),
)
def test_what_revocation_lists_say_counts_even_where_none_is_required(pki, case, code):
    identity, chain = cases.shown(case, pki)
    assert code_of(pki, identity, chain, require_crl=False) == code


def test_one_trusted_itself_without_its_issuer_needs_the_setting(pki):
    peer = root().issue()
    peer.keep(pki.trusted)
    code, sentence = refusal(pki, peer)
    assert code == Codes.BadCertificateChainIncomplete
    assert "security.require_crl = false" in sentence
    assert code_of(pki, peer, require_crl=False) == Codes.Good


def test_a_revocation_list_that_cannot_be_read_is_named_and_harms_no_self_signed_one(pki):
    peer = cases.one_whose_revocation_list_cannot_be_read(pki)
    _, sentence = refusal(pki, peer)
    assert "damaged.crl" in sentence
    assert code_of(pki, cases.trusted_itself(pki, number=4)) == Codes.Good


def test_a_damaged_file_among_the_trusted_ones_harms_nobody_else(pki):
    identity = cases.trusted_itself(pki)
    (pki.trusted / "broken.der").write_bytes(b"rubbish")
    assert code_of(pki, identity) == Codes.Good


def test_a_revocation_list_in_pem_form_and_capital_letters_is_read(pki):
    authority = root()
    authority.keep(pki.trusted)
    (pki.trusted / "AUTHORITY.CRL").write_bytes(authority.crl().public_bytes(PEM))
    assert code_of(pki, authority.issue()) == Codes.Good


@pytest.mark.parametrize("shown", [b"", b"x", b"\x30\x82", b"\x30\x03abc", bytes(20_000)])
def test_what_is_no_certificate_is_refused(pki, shown):
    assert code_of(pki, shown) == Codes.BadCertificateInvalid


def test_a_certificate_cut_short_anywhere_is_refused(pki):
    identity = cases.trusted_itself(pki)
    for size in range(0, len(identity.der), 7):
        assert code_of(pki, identity.der[:size]) == Codes.BadCertificateInvalid


def test_a_changed_file_of_the_same_size_and_time_is_noticed(pki):
    trust = PeerTrust(pki)
    first, second = self_signed(), self_signed(number=4)
    second = self_signed(number=4) if len(first.der) != len(second.der) else second
    file = first.keep(pki.trusted, "peer.der")
    stamp = file.stat()
    assert code_of(pki, first, trust=trust) == Codes.Good
    file.write_bytes(second.der)
    os.utime(file, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    assert code_of(pki, second, trust=trust) == Codes.Good
    assert code_of(pki, first, trust=trust) == Codes.BadCertificateUntrusted


def test_what_was_accepted_is_checked_again_when_its_time_is_over(pki):
    clock = ManualClock(START)
    trust = PeerTrust(pki, clock)
    authority = root()
    authority.keep(pki.trusted)
    authority.keep_crl(pki.issuers, days=(-1, 2))
    peer = authority.issue(days=(-1, 30))
    assert code_of(pki, peer, trust=trust) == Codes.Good
    clock.advance(3 * DAY / dt.timedelta(seconds=1))
    assert code_of(pki, peer, trust=trust) == Codes.BadCertificateRevocationUnknown
    authority.keep_crl(pki.issuers, days=(-1, 60))
    assert code_of(pki, peer, trust=trust) == Codes.Good
    clock.advance(30 * DAY / dt.timedelta(seconds=1))
    assert code_of(pki, peer, trust=trust) in (
        Codes.BadCertificateTimeInvalid,
        Codes.BadCertificateIssuerTimeInvalid,
    )


def test_folders_that_are_being_changed_are_believed_once_they_rest(pki):
    trust = PeerTrust(pki)
    assert not trust.look_again() or trust.look_again()
    cases.trusted_itself(pki)
    assert [trust.look_again() for _ in range(2)] == [False, True]
    looks = []
    for number in range(8):
        self_signed().keep(pki.trusted, f"{number}.der")
        looks.append(trust.look_again())
    assert any(looks)


@pytest.mark.parametrize(
    ("host", "named"),
    [
        ("localhost", True),
        ("LOCALHOST.", True),
        ("127.0.0.1", True),
        ("127.0.0.2", False),
        ("plant", False),
        ("", False),
        ("::1", False),
    ],
)
def test_a_server_is_reached_under_a_name_of_its_certificate(host, named):
    certificate = self_signed(hosts=("localhost", "127.0.0.1")).certificate
    if named:
        check_host_name(certificate, host)
        return
    with pytest.raises(CertificateRefused, match=r"source\.check_host_name = false") as refused:
        check_host_name(certificate, host)
    assert refused.value.code == Codes.BadCertificateHostNameInvalid


def test_an_address_written_as_a_name_does_not_count_nor_does_a_common_name():
    written = x509.SubjectAlternativeName([x509.DNSName("127.0.0.1")])
    identity = self_signed("plant", alternative=None, extra=[written])
    for host in ("127.0.0.1", "plant"):
        with pytest.raises(CertificateRefused):
            check_host_name(identity.certificate, host)


def test_a_subject_with_a_line_break_is_refused_in_one_line(pki):
    peer = self_signed(name("peer\n2026-11-22 [info] session activated by anna\x1b[31m\u2028"))
    code, sentence = refusal(pki, peer)
    assert code == Codes.BadCertificateUntrusted
    assert sentence.isprintable()
    assert r"peer\n2026" in sentence


class TestUsers:
    """A user is trusted by nothing but the own account."""

    @pytest.fixture
    def trust(self, pki):
        return PeerTrust(pki)

    def code(self, trust, user, *anchors, chain=()):
        shown = b"".join(i.der for i in (user, *chain))
        known = frozenset(fingerprint(i.der) for i in anchors)
        try:
            trust.check(shown, Use.USER, anchors=known)
        except CertificateRefused as refused:
            return refused.code
        return Codes.Good

    def test_the_folders_of_applications_let_no_user_in(self, pki, trust):
        user = cases.trusted_itself(pki)
        assert self.code(trust, user) == Codes.BadCertificateUntrusted
        assert self.code(trust, user, user) == Codes.Good
        assert rejected(pki) == ()

    def test_an_authority_lets_in_whom_it_issued_and_did_not_revoke(self, pki, trust):
        authority = root()
        authority.keep(pki.issuers)
        user, bad = authority.issue("anna"), authority.issue("anna")
        assert self.code(trust, user, authority) == Codes.BadCertificateRevocationUnknown
        authority.keep_crl(pki.issuers, bad)
        assert self.code(trust, user, authority) == Codes.Good
        assert self.code(trust, bad, authority) == Codes.BadCertificateRevoked
        assert self.code(trust, bad, bad) == Codes.BadCertificateRevoked

    @pytest.mark.parametrize(
        ("wishes", "code"),
        [
            ({}, Codes.Good),
            ({"uses": ("digital_signature",)}, Codes.Good),
            ({"uses": None, "extended": None}, Codes.Good),
            ({"days": (-30, -1)}, Codes.BadCertificateTimeInvalid),
            ({"days": (2, 30)}, Codes.BadCertificateTimeInvalid),
            ({"uses": ("key_encipherment",)}, Codes.BadCertificateUseNotAllowed),
            ({"extended": [EMAIL]}, Codes.BadCertificateUseNotAllowed),
            (
                {"extended": [ExtendedKeyUsageOID.SERVER_AUTH]},
                Codes.BadCertificateUseNotAllowed,
            ),
            ({"weak": "sha1"}, Codes.BadCertificatePolicyCheckFailed),
        ],
    )
    def test_a_users_own_certificate_is_good_in_its_time_and_use(self, trust, wishes, code):
        user = self_signed("anna", **wishes)
        assert self.code(trust, user, user) == code


def test_authorities_that_certify_each_other_cost_no_more_than_a_few_signatures(pki, monkeypatch):
    """A stranger may send four authorities of one name, each certified by all others."""
    from guarded_opcua.security import certificate_paths

    checked = []
    issued = certificate_paths._issued

    def counted(issuer, certificate):
        checked.append((issuer, certificate))
        return issued(issuer, certificate)

    monkeypatch.setattr(certificate_paths, "_issued", counted)
    same = [root(issuer=root()) for _ in range(4)]
    assert code_of(pki, same[0].issue(), same) == Codes.BadCertificateUntrusted
    assert len(checked) <= 60
    assert len(set(checked)) == len(checked)
