"""``valvemap trust``: applications and users."""

import pytest

from guarded_opcua import Pki, Role, UserStore
from support.certificates import CERTIFY, SIGN, root, self_signed
from valvemap.cli import run

PASSWORD = "correct horse"


@pytest.fixture
def data(tmp_path):
    users = UserStore()
    users.add("anna", Role.OPERATOR, PASSWORD)
    users.save(tmp_path / "users.json")
    return tmp_path


def trust(data, *arguments):
    return run(["trust", *map(str, arguments), "--data", str(data)])


def known(data):
    return UserStore.load(data / "users.json")


def test_a_user_logs_in_with_a_certificate_and_keeps_the_password(data, capsys):
    user = self_signed("anna")
    file = user.keep(data)
    assert trust(data, file, "--user", "anna", "--role", "engineer") == 0
    assert "user anna (engineer) logs in with the certificate CN=anna" in capsys.readouterr().out
    assert known(data).by_certificate(user.certificate).role is Role.ENGINEER
    assert known(data).authenticate("anna", PASSWORD) is Role.ENGINEER


def test_a_new_user_needs_no_password(data):
    user = self_signed("bert")
    assert trust(data, user.keep(data), "--user", "bert", "--role", "Security_Admin") == 0
    assert known(data).by_certificate(user.certificate).role is Role.SECURITY_ADMIN


def test_an_authority_certifies_a_user_and_is_kept_among_the_issuers(data, capsys):
    authority = root(uses=(*SIGN, *CERTIFY))
    assert trust(data, authority.keep(data), "--user", "carl", "--role", "observer") == 0
    assert "for CN=carl" in capsys.readouterr().out
    assert known(data).by_certificate(authority.issue("carl").certificate).name == "carl"
    (kept,) = Pki(data / "pki" / "service").issuers.iterdir()
    assert kept.read_bytes() == authority.der


@pytest.mark.parametrize(
    ("identity", "said"),
    [
        (lambda: self_signed("anna", days=(-30, -1)), "is valid from"),
        (lambda: self_signed("anna", weak="sha1"), "SHA-256"),
        (lambda: self_signed("anna", extended=[root().certificate.signature_algorithm_oid]), "Ext"),
        (lambda: root(days=(-30, -1)), "is valid from"),
    ],
)
def test_what_could_not_log_in_is_not_stored(data, capsys, identity, said):
    before = (data / "users.json").read_bytes()
    assert trust(data, identity().keep(data), "--user", "anna", "--role", "engineer") == 1
    assert said in capsys.readouterr().err
    assert (data / "users.json").read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--user", "anna", "--role", "engineer"), "FILE"),
        (("x.der", "--user", "anna"), "--role"),
        (("x.der", "--role", "engineer"), "--user"),
        (("x.der", "--user", "anna", "--role", "king"), "allowed is one of observer"),
    ],
)
def test_who_asks_wrongly_hears_what_is_allowed(data, capsys, arguments, said):
    assert trust(data, *arguments) == 2
    assert said in capsys.readouterr().err


def test_a_file_that_is_missing_is_named(data, capsys):
    assert trust(data, data / "x.der", "--user", "anna", "--role", "engineer") == 1
    assert "x.der: cannot be read" in capsys.readouterr().err
