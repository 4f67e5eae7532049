"""Who may do what at a node, as attributes (Part 3, 5.2.9 and 8.55)."""

from collections.abc import Iterable
from functools import lru_cache
from typing import Final

from asyncua import ua

from guarded_opcua.address_space.declarations import Method, Variable
from guarded_opcua.security.accounts import Role

ROLE_IDS: Final = {
    Role.OBSERVER: ua.NodeId(ua.ObjectIds.WellKnownRole_Observer),
    Role.OPERATOR: ua.NodeId(ua.ObjectIds.WellKnownRole_Operator),
    Role.ENGINEER: ua.NodeId(ua.ObjectIds.WellKnownRole_Engineer),
    Role.SECURITY_ADMIN: ua.NodeId(ua.ObjectIds.WellKnownRole_SecurityAdmin),
}
_Bits = ua.PermissionType
_OF_CLASS: Final = {
    ua.NodeClass.Variable: _Bits.Read | _Bits.ReadHistory,
    ua.NodeClass.Object: _Bits.ReceiveEvents,
}


def role_permissions(
    kind: ua.NodeClass,
    variable: Variable | None,
    method: Method | None,
    roles: Iterable[Role] = Role,
) -> ua.Variant:
    """Return the RolePermissions of a node for the given roles.

    Parameters
    ----------
    kind
        Class of the node.
    variable, method
        Its declaration, if it is a variable or method of the server's own.

    Examples
    --------
    >>> of_all = role_permissions(ua.NodeClass.Object, None, None)
    >>> [one.RoleId.Identifier for one in of_all.Value]
    [15668, 15680, 16036, 15704]
    """
    writable_by = None if variable is None else variable.writable_by
    required = None if method is None else method.required
    return _stated(kind, writable_by, required, tuple(roles))


@lru_cache(1_000)
def _stated(
    kind: ua.NodeClass, writable_by: Role | None, required: Role | None, roles: tuple[Role, ...]
) -> ua.Variant:
    stated = []
    for role in roles:
        bits = _Bits.Browse | _Bits.ReadRolePermissions | _OF_CLASS.get(kind, _Bits(0))
        if writable_by is not None and role >= writable_by:
            bits |= _Bits.Write
        if kind == ua.NodeClass.Method and (required is None or role >= required):
            bits |= _Bits.Call
        stated.append(ua.RolePermissionType(RoleId=ROLE_IDS[role], Permissions=bits))
    return ua.Variant(stated, ua.VariantType.ExtensionObject, is_array=True)
