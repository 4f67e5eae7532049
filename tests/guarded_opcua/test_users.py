import hashlib
import json
import os
import stat
import sys

import pytest

from guarded_opcua.clock import ManualClock
from guarded_opcua.errors import ConfigurationError
from guarded_opcua.security.accounts import Role
from guarded_opcua.security.certificates import fingerprint, thumbprint
from guarded_opcua.security.passwords import Cost
from guarded_opcua.security.users import UserStore
from support.certificates import root, self_signed

PASSWORD = "correct horse"


@pytest.fixture
def clock():
    return ManualClock()


@pytest.fixture
def store(clock):
    users = UserStore(clock=clock)
    users.add("anna", Role.ENGINEER, PASSWORD)
    return users


@pytest.fixture
def quick_hash(monkeypatch):
    """For many guesses: scrypt takes 40 ms of processor time at each."""
    monkeypatch.setattr(
        "guarded_opcua.security.users.hash_password",
        lambda password, *_: hashlib.sha256(password.encode()).digest(),
    )


def test_the_right_password_gives_the_users_role(store):
    assert store.authenticate("anna", PASSWORD) is Role.ENGINEER


@pytest.mark.parametrize(
    ("name", "password"), [("anna", "wrong horse"), ("anna", ""), ("nobody", PASSWORD), ("", "")]
)
def test_a_wrong_name_or_password_gives_nothing(store, name, password):
    assert store.authenticate(name, password) is None


def test_after_five_failures_even_the_right_password_is_refused_until_the_lock_ends(store, clock):
    for _ in range(5):
        assert store.authenticate("anna", "wrong horse", "10.0.0.1") is None
    assert store.authenticate("anna", PASSWORD, "10.0.0.1") is None
    clock.advance(301.0)
    assert store.authenticate("anna", PASSWORD, "10.0.0.1") is Role.ENGINEER


def test_one_guessing_peer_does_not_lock_the_user_out_elsewhere(store):
    for _ in range(5):
        store.authenticate("anna", "wrong horse", "10.0.0.1")
    assert store.authenticate("anna", PASSWORD, "10.0.0.2") is Role.ENGINEER


@pytest.mark.usefixtures("quick_hash")
def test_many_guessing_peers_lock_the_name_for_everybody(store):
    for peer in range(50):
        store.authenticate("anna", "wrong horse", f"10.0.1.{peer}")
    assert store.authenticate("anna", PASSWORD, "10.0.0.2") is None


@pytest.mark.usefixtures("quick_hash")
def test_a_success_forgets_the_failures_before_it(store):
    for _ in range(3):
        for _ in range(4):
            store.authenticate("anna", "wrong horse")
        assert store.authenticate("anna", PASSWORD) is Role.ENGINEER


def test_names_that_nobody_has_flush_no_users_failures_and_stay_bounded(store, monkeypatch):
    monkeypatch.setattr("guarded_opcua.security.users.hash_password", lambda *_: bytes(32))
    for _ in range(5):
        store.authenticate("anna", "wrong horse", "10.0.0.1")
    for number in range(3000):
        store.authenticate(f"guess-{number}", "wrong horse", "10.0.0.1")
    assert store.locked("anna", "10.0.0.1")
    assert len(store._failures_of_strangers._names) <= 1000


def test_a_name_that_nobody_has_is_locked_as_others_are(store):
    for _ in range(5):
        store.authenticate("berta", "wrong horse", "10.0.0.1")
    assert store.locked("berta", "10.0.0.1")


@pytest.mark.usefixtures("quick_hash")
def test_guesses_from_elsewhere_lock_out_no_address_that_logged_in_before(store):
    assert store.authenticate("anna", PASSWORD, "10.0.0.1") is Role.ENGINEER
    for peer in range(60):
        store.authenticate("anna", "wrong horse", f"10.0.1.{peer}")
    assert store.locked("anna", "10.0.0.2")
    assert store.authenticate("anna", PASSWORD, "10.0.0.1") is Role.ENGINEER


def test_a_saved_store_is_read_back_and_holds_no_password(store, tmp_path):
    file = tmp_path / "users.json"
    store.save(file)
    assert PASSWORD not in file.read_text()
    assert UserStore.load(file).authenticate("anna", PASSWORD) is Role.ENGINEER


def test_a_store_hashes_at_its_cost_and_a_file_of_cheap_hashes_is_refused(tmp_path):
    users = UserStore(cost=Cost(n=2))
    users.add("anna", Role.ENGINEER, PASSWORD)
    assert users.accounts["anna"].cost == (2, 8, 1)
    assert users.authenticate("anna", PASSWORD) is Role.ENGINEER
    users.save(tmp_path / "users.json")
    with pytest.raises(ConfigurationError, match="scrypt cost out of range"):
        UserStore.load(tmp_path / "users.json")


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX modes")
def test_only_the_owner_can_read_a_saved_store(store, tmp_path):
    old = os.umask(0)
    try:
        store.save(tmp_path / "users.json")
    finally:
        os.umask(old)
    assert stat.S_IMODE((tmp_path / "users.json").stat().st_mode) == 0o600


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ("no json", "not a JSON file"),
        ("{}", "a list of users"),
        (json.dumps([{"name": "anna"}]), "user 1"),
        (json.dumps([{"name": "anna", "role": 9, "password_hash": "AA=="}]), "user 1"),
        (json.dumps([{"name": "anna", "role": 1}]), "neither password_hash nor thumbprint"),
        (json.dumps([{"name": "a", "role": 1, "password_hash": "AA==", "n": 2**30}]), "cost"),
        (json.dumps([{"name": "a", "role": 1, "thumbprint": "x"}]), "40 or 64 digits"),
        (json.dumps([{"name": [[]], "role": 1, "thumbprint": "A" * 40}]), "name is .*wrong type"),
        (json.dumps([{"name": "a", "role": 1, "n": 2.0**14}]), "n is .*wrong type"),
        (json.dumps([{"name": "a", "role": 1, "salt": None}]), "salt is .*wrong type"),
    ],
)
def test_a_damaged_file_of_users_is_named_with_its_fault(tmp_path, content, named):
    file = tmp_path / "users.json"
    file.write_text(content)
    with pytest.raises(ConfigurationError, match=named) as caught:
        UserStore.load(file)
    assert "users.json" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_of_users_is_named(tmp_path):
    with pytest.raises(ConfigurationError, match=r"users\.json: cannot be read"):
        UserStore.load(tmp_path / "users.json")


def test_a_short_password_or_an_empty_name_is_refused(store):
    with pytest.raises(ConfigurationError, match="at least 8"):
        store.add("bert", Role.OBSERVER, "short")
    with pytest.raises(ConfigurationError, match="1 to 64"):
        store.add("", Role.OBSERVER, PASSWORD)


def test_a_one_time_password_is_different_each_time():
    first, password = UserStore.one_time("operator", Role.OPERATOR)
    _, other = UserStore.one_time("operator", Role.OPERATOR)
    assert password != other
    assert first.authenticate("operator", password) is Role.OPERATOR


def test_a_user_certificate_gives_the_user(store):
    carl, other = self_signed("carl"), self_signed("carl", number=2)
    store.add_certificate("carl", Role.OPERATOR, carl.der)
    assert store.by_certificate(carl.certificate).role is Role.OPERATOR
    assert store.by_certificate(other.certificate) is None
    assert store.authenticate("carl", "") is None


def test_a_user_with_a_certificate_keeps_the_password(store):
    store.add_certificate("anna", Role.OPERATOR, self_signed("anna").der)
    assert store.authenticate("anna", PASSWORD) is Role.OPERATOR


def test_an_authority_stands_for_whom_it_certifies_by_name(store):
    authority = root()
    store.add_certificate("carl", Role.OPERATOR, authority.der)
    assert store.by_certificate(authority.issue("carl").certificate).name == "carl"
    assert store.by_certificate(authority.issue("anna").certificate) is None
    assert store.accounts["carl"].anchors == {fingerprint(authority.der)}


def test_a_certificate_stored_by_an_earlier_version_is_still_known(tmp_path):
    carl = self_signed("carl")
    file = tmp_path / "users.json"
    file.write_text(json.dumps([{"name": "carl", "role": 2, "thumbprint": thumbprint(carl.der)}]))
    store = UserStore.load(file)
    assert store.by_certificate(carl.certificate).name == "carl"
    store.save(file)
    assert UserStore.load(file).by_certificate(carl.certificate).name == "carl"


def test_what_is_no_certificate_is_no_users(store):
    with pytest.raises(ConfigurationError, match=r"user carl: not an X\.509 certificate"):
        store.add_certificate("carl", Role.OPERATOR, b"rubbish")


def test_a_changed_file_of_users_is_read_again_and_a_damaged_one_changes_nothing(store, tmp_path):
    file = tmp_path / "users.json"
    store.save(file)
    running = UserStore.load(file)
    assert not running.refresh()
    store.add_certificate("carl", Role.OPERATOR, self_signed("carl").der)
    store.save(file)
    assert running.refresh()
    assert running.names == ("anna", "carl")
    file.write_text("rubbish")
    assert not running.refresh()
    assert running.names == ("anna", "carl")


def test_a_removed_user_is_gone_and_an_unknown_one_named(store):
    store.remove("anna")
    assert store.authenticate("anna", PASSWORD) is None
    with pytest.raises(ConfigurationError, match="anna: unknown"):
        store.remove("anna")
