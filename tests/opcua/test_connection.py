import struct

import pytest
from asyncua import ua

from valvemap.errors import SourceLost, SourceRejected
from valvemap.opcua_client.source_errors import source_errors, status_name

URL = "opc.tcp://plant:4840/"


@pytest.mark.parametrize(
    "error",
    [
        TimeoutError(),
        ConnectionRefusedError(111, "Connection refused"),
        ConnectionError("connection lost"),
        ua.UaStatusCodeError(ua.StatusCodes.BadTooManySessions),
        ua.UaStatusCodeError(ua.StatusCodes.BadSessionIdInvalid),
        ua.UaStatusCodeError(0x8FFF0000),
        ua.UaError("Server certificate mismatch"),
        struct.error("unpack requires a buffer of 4 bytes"),
        KeyError("x"),
    ],
    ids=repr,
)
def test_what_may_pass_is_a_loss_that_names_server_and_act(error):
    with pytest.raises(SourceLost) as lost, source_errors(URL, "subscribing"):
        raise error
    assert str(lost.value).startswith(f"{URL}: ")
    assert "while subscribing" in str(lost.value)
    assert "\n" not in str(lost.value)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (ua.StatusCodes.BadUserAccessDenied, "user or password"),
        (ua.StatusCodes.BadIdentityTokenRejected, "user or password"),
        (ua.StatusCodes.BadCertificateUntrusted, "certificate"),
        (ua.StatusCodes.BadSecurityChecksFailed, "certificate"),
        (ua.StatusCodes.BadSecurityPolicyRejected, "security"),
    ],
)
def test_what_will_not_pass_by_itself_is_a_rejection_with_a_reason(code, words):
    with pytest.raises(SourceRejected, match=words), source_errors(URL, "connecting"):
        raise ua.UaStatusCodeError(code)


def test_our_own_mistakes_are_not_the_servers():
    with pytest.raises(ZeroDivisionError), source_errors(URL, "connecting"):
        raise ZeroDivisionError


def test_a_status_code_is_named_whatever_its_info_bits():
    assert status_name(ua.StatusCodes.BadNoCommunication | 0x480) == "BadNoCommunication"
    assert status_name(0x8FFF0000) == "Bad (0x8fff0000)"
