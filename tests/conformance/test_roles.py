"""No method is dead for an operator or an engineer, who may call what an observer may not."""

import pytest

from conformance.stacks import STACKS
from conformance.sweep import DENIED, answers_of_methods, dead_methods
from support.interoperation import raised
from support.peer import Peer

ROLES = "observer", "operator", "engineer"
NEED = {"node-opcua": pytest.mark.node, "open62541, in o6": pytest.mark.languages}


@pytest.mark.timeout(900)  # npm installs
@pytest.mark.parametrize("name", [pytest.param(name, marks=NEED[name]) for name in NEED])
async def test_every_method_answers_every_role(name, request, tmp_path):
    program = STACKS[name].program(request.config.cache.mkdir)
    found = {}
    async with raised(tmp_path) as stage:
        for role in ROLES:
            peer = await Peer.start(*program)
            try:
                await peer.ask("connect", **stage.who(role))
                found[role] = await answers_of_methods(peer)
                await peer.ask("disconnect")
            finally:
                await peer.stop()
    assert [dead_methods(found[role]) for role in ROLES] == [[], [], []]
    denied = [list(found[role].values()).count(DENIED) for role in ROLES]
    assert denied[0] > 0
    assert denied[1:] == [0, 0]
