"""Every stack may call the methods that RolePermissions allow its user, and no others."""

import pytest
from asyncua import ua

from conformance.stacks import STACKS
from conformance.sweep import DENIED, answers_of_methods, dead_methods
from guarded_opcua import Role
from guarded_opcua.address_space.role_permissions import role_permissions
from support.interoperation import raised
from support.peer import Peer

ROLES = {"observer": Role.OBSERVER, "operator": Role.OPERATOR, "engineer": Role.ENGINEER}
ANONYMOUS = "anonymous"
NEED = {
    "node-opcua": pytest.mark.node,
    "gopcua": pytest.mark.languages,
    "Eclipse Milo": pytest.mark.milo,
    "open62541, in o6": pytest.mark.languages,
}


def denied_by_permissions(stage, role):
    """The service's own methods whose RolePermissions do not allow a role to call them."""
    kind = ua.NodeClass.Method
    return {
        str(id_.Identifier)
        for id_, method in stage.server._server._methods.items()
        for of_role in role_permissions(kind, None, method, [role]).Value
        if not of_role.Permissions & ua.PermissionType.Call
    }


def denied(answers, known):
    """Those of known methods that a client was denied."""
    ids = {method.rpartition("s=")[2] for (_, method), code in answers.items() if code == DENIED}
    return ids & known


async def swept(program, who):
    peer = await Peer.start(*program)
    try:
        await peer.ask("connect", **who)
        found = await answers_of_methods(peer)
        await peer.ask("disconnect")
    finally:
        await peer.stop()
    return found


@pytest.mark.timeout(900)  # npm installs
@pytest.mark.parametrize("name", [pytest.param(name, marks=NEED[name]) for name in STACKS])
async def test_every_method_answers_every_role_as_its_permissions_say(name, request, tmp_path):
    program = STACKS[name].program(request.config.cache.mkdir)
    found, expected, known = {}, {}, set()
    async with raised(tmp_path / "secured") as stage:
        for name_of, role in ROLES.items():
            found[name_of] = await swept(program, stage.who(name_of))
            expected[name_of] = denied_by_permissions(stage, role)
            known |= {str(id_.Identifier) for id_ in stage.server._server._methods}
    async with raised(tmp_path / "open", none_on_loopback=True) as stage:
        found[ANONYMOUS] = await swept(program, {"url": stage.server.url})
    expected[ANONYMOUS] = expected["observer"]
    assert not [of for answers in found.values() for of in dead_methods(answers)]
    assert {who: denied(answers, known) for who, answers in found.items()} == expected
    assert len(expected["observer"]) > len(expected["operator"]) >= len(expected["engineer"]) == 0
