"""Read, Write and Call with the permissions of a user (Part 4, 5.11)."""

import dataclasses
import inspect
from collections.abc import Callable, Mapping
from typing import Any

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from guarded_opcua.address_space.declarations import Method, Variable
from guarded_opcua.address_space.held_attributes import (
    held_attribute,
    is_missing,
    is_readable,
)
from guarded_opcua.address_space.method_calls import Outside, call_method, rejection_code
from guarded_opcua.address_space.plain_values import check, plain
from guarded_opcua.address_space.role_permissions import role_permissions
from guarded_opcua.binary.index_range import IndexRangeError, parse_index_range, select
from guarded_opcua.errors import CommandRejected
from guarded_opcua.logs import bounded_logger
from guarded_opcua.security.accounts import Role

_log = bounded_logger(__name__)
_Codes = ua.StatusCodes
_PERMISSIONS = (ua.AttributeIds.RolePermissions, ua.AttributeIds.UserRolePermissions)
_WRITE_BIT = 1 << ua.AccessLevel.CurrentWrite


class Attributes:
    """Reads and writes the attributes of all nodes, subject to the user's role."""

    def __init__(
        self,
        aspace: AddressSpace,
        variables: Mapping[ua.NodeId, Variable],
        methods: Mapping[ua.NodeId, Method],
        take_write: Callable[[Variable, Any, Any], None],
        utc: Callable[[], Any],
    ) -> None:
        self._aspace = aspace
        self._variables = variables
        self._methods = methods
        self._take_write = take_write
        self._utc = utc

    def read(self, wanted: ua.ReadValueId, role: Role) -> ua.DataValue:
        """Read one attribute, or a part of it."""
        held = held_attribute(self._aspace, wanted.NodeId, wanted.AttributeId)
        if wanted.AttributeId in _PERMISSIONS:
            held = self._permissions(wanted, role)
        if wanted.AttributeId != ua.AttributeIds.Value:
            if wanted.IndexRange or _has_encoding(wanted):
                return _bad(_Codes.BadIndexRangeNoData)
            held = self._for_role(wanted, held, role)
            return dataclasses.replace(held, SourceTimestamp=None, ServerTimestamp=self._utc())
        if is_missing(held):
            return held
        if _has_encoding(wanted):
            return _bad(_Codes.BadDataEncodingInvalid)
        if not is_readable(self._aspace, wanted.NodeId):
            return _bad(_Codes.BadNotReadable)
        if held.ServerTimestamp is None:
            held = dataclasses.replace(held, ServerTimestamp=self._utc())
        return _part(held, wanted.IndexRange) if wanted.IndexRange else held

    def held(self, item: ua.WriteValue) -> ua.DataValue:
        """Return the value before a write."""
        return held_attribute(self._aspace, item.NodeId, item.AttributeId)

    async def write(  # noqa: PLR0911 - one per reason
        self, item: ua.WriteValue, role: Role, outside: Outside
    ) -> int:
        """Write one value; return a status code."""
        held = self.held(item)
        if is_missing(held):
            return int(held.StatusCode.value)
        variable = self._variables.get(item.NodeId)
        if item.AttributeId != ua.AttributeIds.Value or not variable or not variable.writable_by:
            return _Codes.BadNotWritable
        if role < variable.writable_by:
            return _Codes.BadUserAccessDenied
        status = item.Value.StatusCode
        if item.IndexRange or (status is not None and status.value != _Codes.Good):
            return _Codes.BadWriteNotSupported
        code = check(variable, item.Value.Value)
        if code != _Codes.Good:
            return code
        value = plain(item.Value.Value)
        try:
            if variable.on_write is not None:
                outcome = variable.on_write(value)
                if inspect.isawaitable(outcome):
                    await outside(outcome)
        except CommandRejected as error:
            _log.warning("%s: write refused: %s", item.NodeId.Identifier, error)
            return rejection_code(error)
        except Exception:  # noqa: BLE001 - each write is answered, even if its handler fails
            _log.exception("%s: write failed", item.NodeId.Identifier)
            return _Codes.BadInternalError
        self._take_write(variable, value, item.Value.SourceTimestamp)
        return _Codes.Good

    async def call(
        self, request: ua.CallMethodRequest, role: Role, outside: Outside
    ) -> ua.CallMethodResult:
        """Call a method of the server's namespace."""
        owner = self._aspace.get(request.ObjectId)
        if owner is None or request.MethodId not in self._aspace:
            return _no_call(_Codes.BadNodeIdUnknown)
        if not any(ref.IsForward and ref.NodeId == request.MethodId for ref in owner.references):
            return _no_call(_Codes.BadMethodInvalid)
        method = self._methods.get(request.MethodId)
        if method is None:
            return _no_call(_Codes.BadNotImplemented)
        if role < method.required:
            return _no_call(_Codes.BadUserAccessDenied)
        return await call_method(method, request.InputArguments or [], outside)

    def _permissions(self, wanted: ua.ReadValueId, role: Role) -> ua.DataValue:
        """Return who may do what, or what the user's roles may; a role includes the lower ones."""
        kind = held_attribute(self._aspace, wanted.NodeId, ua.AttributeIds.NodeClass)
        if is_missing(kind) or kind.Value is None:
            return kind
        own = wanted.AttributeId == ua.AttributeIds.UserRolePermissions
        stated = role_permissions(
            ua.NodeClass(kind.Value.Value),
            self._variables.get(wanted.NodeId),
            self._methods.get(wanted.NodeId),
            [one for one in Role if one <= role] if own else Role,
        )
        return ua.DataValue(stated)

    def _for_role(self, wanted: ua.ReadValueId, held: ua.DataValue, role: Role) -> ua.DataValue:
        if wanted.AttributeId == ua.AttributeIds.UserAccessLevel:
            variable = self._variables.get(wanted.NodeId)
            if variable and variable.writable_by and role < variable.writable_by:
                level = held.Value.Value & ~_WRITE_BIT
                return ua.DataValue(ua.Variant(level, ua.VariantType.Byte))
        if wanted.AttributeId == ua.AttributeIds.UserExecutable:
            method = self._methods.get(wanted.NodeId)
            if method is not None:
                return ua.DataValue(ua.Variant(role >= method.required, ua.VariantType.Boolean))
        return held


def _part(held: ua.DataValue, text: str) -> ua.DataValue:
    try:
        ranges = parse_index_range(text)
    except IndexRangeError:
        return _bad(_Codes.BadIndexRangeInvalid)
    if held.Value is None or held.Value.VariantType == ua.VariantType.Null:
        return held
    piece = select(held.Value, ranges)
    if piece is None:
        return _bad(_Codes.BadIndexRangeNoData)
    return dataclasses.replace(held, Value=piece)


def _has_encoding(wanted: ua.ReadValueId) -> bool:
    return wanted.DataEncoding is not None and bool(wanted.DataEncoding.Name)


def _bad(code: int) -> ua.DataValue:
    return ua.DataValue(StatusCode=ua.StatusCode(code))


def _no_call(code: int) -> ua.CallMethodResult:
    return ua.CallMethodResult(StatusCode=ua.StatusCode(code))
