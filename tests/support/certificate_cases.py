"""Certificates that must be refused, and some that must not, with the reason's status code.

Each case fills the folders of a :class:`Pki` and returns who shows up: an identity, or an identity
and the chain that it sends along. ``use`` is what its ExtendedKeyUsage must allow.
"""

import ipaddress

from asyncua import ua
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from support.certificates import (
    CERTIFY,
    EMAIL,
    SIGN,
    UNKNOWN,
    Identity,
    key,
    make,
    make_authority,
    name,
    revocation,
    root,
    self_signed,
)

Codes = ua.StatusCodes
LATER, PAST = (2, 30), (-30, -1)
POINT = x509.UniformResourceIdentifier("http://crl.example/1.crl")


def trusted_root(pki, **wishes):
    """An authority that we trust, with a revocation list that revokes nobody."""
    authority = root(**wishes)
    authority.keep(pki.trusted)
    authority.keep_crl(pki.issuers)
    return authority


def trusted_itself(pki, **wishes):
    identity = self_signed(**wishes)
    identity.keep(pki.trusted)
    return identity


def below_an_intermediate(pki, top=None, middle=None, **wishes):
    """A peer of an intermediate authority of a trusted root, both with revocation lists."""
    authority = trusted_root(pki, **(top or {}))
    between = authority.authority(**(middle or {}))
    between.keep(pki.issuers)
    between.keep_crl(pki.issuers)
    return between.issue(**wishes)


def revoked(pki, **wishes):
    authority = root()
    authority.keep(pki.trusted)
    peer = authority.issue()
    authority.keep_crl(pki.issuers, peer, **wishes)
    return peer


def with_crl(pki, **wishes):
    """A peer of a trusted root whose revocation list is as wished."""
    authority = root()
    authority.keep(pki.trusted)
    authority.keep_crl(pki.issuers, **wishes)
    return authority.issue()


def with_scope(pki, points=None, **scope):
    nothing = {
        "full_name": None,
        "relative_name": None,
        "only_contains_user_certs": False,
        "only_contains_ca_certs": False,
        "only_some_reasons": None,
        "indirect_crl": False,
        "only_contains_attribute_certs": False,
    }
    authority = root()
    authority.keep(pki.trusted)
    authority.keep_crl(pki.issuers, extra=[x509.IssuingDistributionPoint(**{**nothing, **scope})])
    return authority.issue(points=points)


def constrained(pki, permitted=None, excluded=None, **wishes):
    limits = x509.NameConstraints(permitted, excluded)
    authority = trusted_root(pki, extra=[limits], critical=True)
    return authority.issue(**wishes)


# -- refused --------------------------------------------------------------------------------


def an_unknown_one(_):
    return self_signed()


def a_trusted_one_that_has_expired(pki):
    return trusted_itself(pki, days=PAST)


def a_trusted_one_that_is_not_yet_valid(pki):
    return trusted_itself(pki, days=LATER)


def one_of_an_authority_that_has_expired(pki):
    return trusted_root(pki, days=PAST).issue()


def one_below_an_intermediate_that_has_expired(pki):
    return below_an_intermediate(pki, middle={"days": PAST})


def one_of_an_authority_that_is_no_authority(pki):
    return trusted_root(pki, ca=False).issue()


def one_of_an_authority_without_basic_constraints(pki):
    return trusted_root(pki, ca=None).issue()


def one_of_an_issuer_without_keyCertSign(pki):
    return trusted_root(pki, uses=(*SIGN, "crl_sign")).issue()


def one_below_an_intermediate_without_keyCertSign(pki):
    return below_an_intermediate(pki, middle={"uses": ("crl_sign", "digital_signature")})


def one_of_an_issuer_without_KeyUsage(pki):
    return trusted_root(pki, uses=None).issue()


def one_issued_by_a_trusted_application(pki):
    application = trusted_itself(pki, subject="application", number=2, uses=(*SIGN, *CERTIFY))
    application.keep_crl(pki.issuers)
    return application.issue()


def one_below_more_authorities_than_allowed(pki):
    return below_an_intermediate(pki, top={"path_length": 0})


def one_without_KeyUsage(pki):
    return trusted_itself(pki, uses=None)


def one_of_an_authority_without_KeyUsage_of_its_own(pki):
    return trusted_root(pki).issue(uses=None)


def one_that_may_not_sign(pki):
    return trusted_itself(pki, uses=("key_encipherment", "data_encipherment"))


def one_that_may_not_encipher_keys(pki):
    return trusted_itself(pki, uses=("digital_signature", "content_commitment"))


def one_for_mail_only(pki):
    return trusted_itself(pki, extended=[EMAIL])


def one_of_an_authority_for_mail_only(pki):
    return trusted_root(pki).issue(extended=[EMAIL])


def one_of_an_authority_that_certifies_mail_only(pki):
    return trusted_root(pki, extended=[EMAIL]).issue()


def one_with_an_unknown_critical_extension(pki):
    return trusted_itself(pki, extra=[UNKNOWN], critical=True)


def one_of_an_authority_with_an_unknown_critical_extension(pki):
    return trusted_root(pki, extra=[UNKNOWN], critical=True).issue()


def one_with_a_name_that_its_authority_may_not_certify(pki):
    return constrained(pki, permitted=[x509.DNSName("plant.example")], hosts=["other.example"])


def one_with_an_address_that_its_authority_may_not_certify(pki):
    network = x509.IPAddress(ipaddress.ip_network("127.0.0.0/8"))
    return constrained(pki, excluded=[network])


def one_with_a_subject_that_its_authority_may_not_certify(pki):
    return constrained(pki, permitted=[x509.DirectoryName(name("somebody else"))])


def one_with_an_application_uri_under_constraints_on_hosts(pki):
    return constrained(pki, permitted=[x509.UniformResourceIdentifier("plant.example")])


def one_signed_with_sha1(pki):
    return trusted_itself(pki, weak="sha1")


def one_of_an_authority_signed_with_md5(pki):
    return trusted_root(pki).issue(weak="md5")


def one_of_an_authority_that_is_itself_signed_with_sha1(pki):
    return below_an_intermediate(pki, middle={"weak": "sha1"})


def one_with_a_key_of_1024_bits(pki):
    identity = make("peer", key(1, bits=1024))
    identity.keep(pki.trusted)
    return identity


def one_of_an_authority_with_a_key_of_1024_bits(pki):
    authority = make_authority("authority", key(2, bits=1024))
    authority.keep(pki.trusted)
    authority.keep_crl(pki.issuers)
    return authority.issue()


def one_whose_issuer_is_missing(pki):
    middle = root().authority()
    middle.keep(pki.trusted)
    middle.keep_crl(pki.issuers)
    return middle.issue()


def one_of_an_authority_that_is_only_an_issuer(pki):
    authority = root()
    authority.keep(pki.issuers)
    authority.keep_crl(pki.issuers)
    return authority.issue()


def one_of_an_authority_that_it_brought_along(_):
    authority = root()
    return authority.issue(), [authority]


def one_that_forged_the_name_of_an_authority(pki):
    trusted_root(pki)
    return make("peer", key(1), issuer_name=name("authority"))


def one_of_a_root_that_did_not_sign_itself(pki):
    forged = root(issuer=Identity(root().certificate, key(4)))
    forged.keep(pki.trusted)
    forged.keep_crl(pki.issuers)
    return forged.issue()


def one_without_a_revocation_list(pki):
    authority = root()
    authority.keep(pki.trusted)
    return authority.issue()


def one_below_an_intermediate_without_a_revocation_list(pki):
    authority = root()
    authority.keep(pki.trusted)
    between = authority.authority()
    between.keep(pki.issuers)
    between.keep_crl(pki.issuers)
    return between.issue()


def one_whose_revocation_list_has_expired(pki):
    return with_crl(pki, days=PAST)


def one_whose_revocation_list_is_of_the_future(pki):
    return with_crl(pki, days=LATER)


def one_whose_revocation_list_another_signed(pki):
    return with_crl(pki, signer=root(number=4))


def one_whose_revocation_list_was_signed_without_cRLSign(pki):
    return trusted_root(pki, uses=("key_cert_sign",)).issue()


def one_with_nothing_but_a_delta(pki):
    return with_crl(pki, extra=[x509.DeltaCRLIndicator(1)])


def one_with_an_indirect_revocation_list(pki):
    return with_scope(pki, indirect_crl=True)


def one_with_a_revocation_list_for_authorities_only(pki):
    return with_scope(pki, only_contains_ca_certs=True)


def one_with_a_revocation_list_for_another_point(pki):
    return with_scope(pki, full_name=[POINT])


def one_whose_revocation_list_has_an_unknown_critical_extension(pki):
    return with_crl(pki, extra=[UNKNOWN])


def one_whose_revocation_list_cannot_be_read(pki):
    peer = trusted_root(pki).issue()
    (pki.issuers / "damaged.crl").write_bytes(b"rubbish")
    return peer


def a_revoked_one(pki):
    return revoked(pki)


def one_that_a_delta_revokes(pki):
    authority = trusted_root(pki)
    peer = authority.issue()
    authority.keep_crl(pki.issuers, peer, file="delta.crl", extra=[x509.DeltaCRLIndicator(1)])
    return peer


def one_that_an_expired_list_revokes(pki):
    authority = trusted_root(pki)
    peer = authority.issue()
    authority.keep_crl(pki.issuers, peer, file="old.crl", days=PAST)
    return peer


def a_revoked_one_that_is_trusted_itself(pki):
    peer = revoked(pki)
    peer.keep(pki.trusted)
    return peer


def one_below_a_revoked_intermediate(pki):
    authority = root()
    authority.keep(pki.trusted)
    between = authority.authority()
    between.keep(pki.issuers)
    between.keep_crl(pki.issuers)
    authority.keep_crl(pki.issuers, between)
    return between.issue()


REFUSED = {
    an_unknown_one: Codes.BadCertificateUntrusted,
    a_trusted_one_that_has_expired: Codes.BadCertificateTimeInvalid,
    a_trusted_one_that_is_not_yet_valid: Codes.BadCertificateTimeInvalid,
    one_of_an_authority_that_has_expired: Codes.BadCertificateIssuerTimeInvalid,
    one_below_an_intermediate_that_has_expired: Codes.BadCertificateIssuerTimeInvalid,
    one_of_an_authority_that_is_no_authority: Codes.BadCertificateIssuerUseNotAllowed,
    one_of_an_authority_without_basic_constraints: Codes.BadCertificateIssuerUseNotAllowed,
    one_of_an_issuer_without_keyCertSign: Codes.BadCertificateIssuerUseNotAllowed,
    one_below_an_intermediate_without_keyCertSign: Codes.BadCertificateIssuerUseNotAllowed,
    one_of_an_issuer_without_KeyUsage: Codes.BadCertificateIssuerUseNotAllowed,
    one_issued_by_a_trusted_application: Codes.BadCertificateIssuerUseNotAllowed,
    one_below_more_authorities_than_allowed: Codes.BadCertificateIssuerUseNotAllowed,
    one_without_KeyUsage: Codes.BadCertificateUseNotAllowed,
    one_of_an_authority_without_KeyUsage_of_its_own: Codes.BadCertificateUseNotAllowed,
    one_that_may_not_sign: Codes.BadCertificateUseNotAllowed,
    one_that_may_not_encipher_keys: Codes.BadCertificateUseNotAllowed,
    one_for_mail_only: Codes.BadCertificateUseNotAllowed,
    one_of_an_authority_for_mail_only: Codes.BadCertificateUseNotAllowed,
    one_of_an_authority_that_certifies_mail_only: Codes.BadCertificateIssuerUseNotAllowed,
    one_with_an_unknown_critical_extension: Codes.BadCertificateInvalid,
    one_of_an_authority_with_an_unknown_critical_extension: Codes.BadCertificateInvalid,
    one_with_a_name_that_its_authority_may_not_certify: Codes.BadCertificateIssuerUseNotAllowed,
    one_with_an_address_that_its_authority_may_not_certify: (
        Codes.BadCertificateIssuerUseNotAllowed
    ),
    one_with_a_subject_that_its_authority_may_not_certify: (
        Codes.BadCertificateIssuerUseNotAllowed
    ),
    one_with_an_application_uri_under_constraints_on_hosts: (
        Codes.BadCertificateIssuerUseNotAllowed
    ),
    one_signed_with_sha1: Codes.BadCertificatePolicyCheckFailed,
    one_of_an_authority_signed_with_md5: Codes.BadCertificatePolicyCheckFailed,
    one_of_an_authority_that_is_itself_signed_with_sha1: Codes.BadCertificatePolicyCheckFailed,
    one_with_a_key_of_1024_bits: Codes.BadCertificatePolicyCheckFailed,
    one_of_an_authority_with_a_key_of_1024_bits: Codes.BadCertificatePolicyCheckFailed,
    one_whose_issuer_is_missing: Codes.BadCertificateChainIncomplete,
    one_of_an_authority_that_is_only_an_issuer: Codes.BadCertificateUntrusted,
    one_of_an_authority_that_it_brought_along: Codes.BadCertificateUntrusted,
    one_that_forged_the_name_of_an_authority: Codes.BadCertificateUntrusted,
    one_of_a_root_that_did_not_sign_itself: Codes.BadCertificateInvalid,
    one_without_a_revocation_list: Codes.BadCertificateRevocationUnknown,
    one_below_an_intermediate_without_a_revocation_list: (
        Codes.BadCertificateIssuerRevocationUnknown
    ),
    one_whose_revocation_list_has_expired: Codes.BadCertificateRevocationUnknown,
    one_whose_revocation_list_is_of_the_future: Codes.BadCertificateRevocationUnknown,
    one_whose_revocation_list_another_signed: Codes.BadCertificateRevocationUnknown,
    one_whose_revocation_list_was_signed_without_cRLSign: Codes.BadCertificateRevocationUnknown,
    one_with_nothing_but_a_delta: Codes.BadCertificateRevocationUnknown,
    one_with_an_indirect_revocation_list: Codes.BadCertificateRevocationUnknown,
    one_with_a_revocation_list_for_authorities_only: Codes.BadCertificateRevocationUnknown,
    one_with_a_revocation_list_for_another_point: Codes.BadCertificateRevocationUnknown,
    one_whose_revocation_list_has_an_unknown_critical_extension: (
        Codes.BadCertificateRevocationUnknown
    ),
    one_whose_revocation_list_cannot_be_read: Codes.BadCertificateRevocationUnknown,
    a_revoked_one: Codes.BadCertificateRevoked,
    one_that_a_delta_revokes: Codes.BadCertificateRevoked,
    one_that_an_expired_list_revokes: Codes.BadCertificateRevoked,
    a_revoked_one_that_is_trusted_itself: Codes.BadCertificateRevoked,
    one_below_a_revoked_intermediate: Codes.BadCertificateIssuerRevoked,
}


# -- accepted -------------------------------------------------------------------------------


def one_that_is_trusted_itself(pki):
    return trusted_itself(pki)


def one_of_a_trusted_authority(pki):
    return trusted_root(pki).issue()


def one_below_an_intermediate(pki):
    return below_an_intermediate(pki, top={"path_length": 1}, middle={"path_length": 0})


def one_that_brings_its_intermediate_along(pki):
    authority = trusted_root(pki)
    between = authority.authority()
    between.keep_crl(pki.issuers)
    return between.issue(), [between]


def one_of_a_trusted_intermediate_below_an_issuer(pki):
    top = root()
    top.keep(pki.issuers)
    top.keep_crl(pki.issuers)
    between = top.authority()
    between.keep(pki.trusted)
    between.keep_crl(pki.issuers)
    return between.issue()


def one_trusted_itself_below_an_issuer(pki):
    top = root()
    top.keep(pki.issuers)
    top.keep_crl(pki.issuers)
    peer = top.issue()
    peer.keep(pki.trusted)
    return peer


def one_of_the_second_of_two_authorities_of_one_name(pki):
    root(number=4).keep(pki.trusted, "1.der")
    authority = root()
    authority.keep(pki.trusted, "2.der")
    authority.keep_crl(pki.issuers, file="2.crl")
    root(number=4).keep_crl(pki.issuers, authority, file="1.crl")
    return authority.issue()


def one_of_an_authority_whose_first_certificate_has_expired(pki):
    root(days=PAST).keep(pki.trusted, "1.der")
    authority = root()
    authority.keep(pki.trusted, "2.der")
    authority.keep_crl(pki.issuers)
    return authority.issue()


def one_on_the_only_way_through_crossed_authorities(pki):
    """Two certificates for one intermediate key; the way that is tried first ends untrusted."""
    authority, stranger = root(), root("stranger", number=4)
    stranger.keep(pki.issuers, "1.der")
    stranger.authority().keep(pki.issuers, "2.der")
    authority.keep(pki.trusted, "3.der")
    authority.keep_crl(pki.issuers, file="1.crl")
    between = authority.authority()
    between.keep(pki.issuers, "4.der")
    between.keep_crl(pki.issuers, file="2.crl")
    return between.issue()


def one_whose_name_is_within_the_constraints(pki):
    tree = [x509.DNSName("example"), x509.IPAddress(ipaddress.ip_network("127.0.0.0/8"))]
    return constrained(pki, permitted=tree, hosts=["plant.example", "127.0.0.1"])


def one_with_a_revocation_list_of_its_own_point(pki):
    points = [x509.DistributionPoint([POINT], None, None, None)]
    return with_scope(pki, points=points, full_name=[POINT])


def one_of_an_authority_that_revoked_somebody_else(pki):
    authority = root()
    authority.keep(pki.trusted)
    authority.keep_crl(pki.issuers, self_signed("somebody else"))
    return authority.issue()


def one_whose_revocation_a_delta_takes_back(pki):
    authority = trusted_root(pki)
    peer = authority.issue()
    entry = revocation(peer, x509.ReasonFlags.remove_from_crl)
    authority.keep_crl(pki.issuers, entry, file="delta.crl", extra=[x509.DeltaCRLIndicator(1)])
    return peer


def one_without_ExtendedKeyUsage(pki):
    return trusted_itself(pki, extended=None)


def one_for_any_extended_use(pki):
    return trusted_itself(pki, extended=[EMAIL, ExtendedKeyUsageOID.ANY_EXTENDED_KEY_USAGE])


def one_with_an_unknown_extension_that_is_not_critical(pki):
    return trusted_itself(pki, extra=[UNKNOWN])


ACCEPTED = [
    one_that_is_trusted_itself,
    one_of_a_trusted_authority,
    one_below_an_intermediate,
    one_that_brings_its_intermediate_along,
    one_of_a_trusted_intermediate_below_an_issuer,
    one_trusted_itself_below_an_issuer,
    one_of_the_second_of_two_authorities_of_one_name,
    one_of_an_authority_whose_first_certificate_has_expired,
    one_on_the_only_way_through_crossed_authorities,
    one_whose_name_is_within_the_constraints,
    one_with_a_revocation_list_of_its_own_point,
    one_of_an_authority_that_revoked_somebody_else,
    one_whose_revocation_a_delta_takes_back,
    one_without_ExtendedKeyUsage,
    one_for_any_extended_use,
    one_with_an_unknown_extension_that_is_not_critical,
]


def shown(case, pki):
    """Fill the folders for a case; return who shows up and what is sent along."""
    for folder in (pki.trusted, pki.issuers, pki.rejected):
        for file in folder.iterdir():
            file.unlink()
    found = case(pki)
    return found if isinstance(found, tuple) else (found, [])
