"""Decodes responses of a source server with the guarded server's decoder, within a budget.

Publish and Republish responses are decoded by :mod:`valvemap.opcua_source.decoding`.
"""

from typing import Any, TypeVar

from asyncua import ua

from guarded_opcua.binary.bounded_decoding import Budget, Malformed, Reader, TooMuch, decode

_T = TypeVar("_T")

_RESPONSE_BYTES = 2 * 1024 * 1024  # 10,000 values take a tenth of that
_BUDGET = Budget(
    elements=20_000,  # at most 10,000 values are requested at once
    array_length=500_000,  # enough to decode an array node, so the error can name it
    string_bytes=256 * 1024,  # certificate chains are the longest
    nesting=16,
)
_FAULT = ua.ObjectIds.ServiceFault_Encoding_DefaultBinary


class Senseless(ua.UaError):
    """The server sent an invalid message; the text describes it."""


def decode_response(kind: type[_T], body: bytes) -> _T:
    """Decode a response from its TypeId on.

    Raises
    ------
    Senseless
        if it is another response, cannot be decoded or exceeds the budget.
    UaStatusCodeError
        if the ServiceResult is not Good.
    """
    response: Any = decode_part(kind, body)
    if response.TypeId != kind().TypeId:  # type: ignore[attr-defined]
        raise Senseless(f"something else than a {kind.__name__}")
    response.ResponseHeader.ServiceResult.check()
    return response


def decode_part(kind: type[_T], body: bytes) -> _T:
    """Decode a structure at the beginning of ``body``.

    Raises
    ------
    Senseless
        if it cannot be decoded or exceeds the budget.
    """
    if len(body) > _RESPONSE_BYTES:
        raise Senseless(
            f"a {kind.__name__} of {len(body)} bytes, at most {_RESPONSE_BYTES} are read"
        )
    try:
        return decode(kind, Reader(body, _BUDGET))
    except TooMuch:
        raise Senseless(f"a {kind.__name__} that holds more than is read of one") from None
    except Malformed:
        raise Senseless(f"a {kind.__name__} that cannot be decoded") from None


def check_fault(body: bytes) -> None:
    """Raise the StatusCode of a ServiceFault; return if the response is not one.

    Raises
    ------
    UaStatusCodeError, Senseless
    """
    kind = decode_type(body)
    if kind.NamespaceIndex == 0 and kind.Identifier == _FAULT:
        decode_part(ua.ServiceFault, body).ResponseHeader.ServiceResult.check()
        raise Senseless("a fault that is none")


def decode_type(body: bytes) -> ua.NodeId:
    """Decode the NodeId that a response begins with.

    Raises
    ------
    Senseless
    """
    try:
        return decode(ua.NodeId, Reader(body, _BUDGET))
    except ua.UaStatusCodeError:
        raise Senseless("a response of no type") from None
