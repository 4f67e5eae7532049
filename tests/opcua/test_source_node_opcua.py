"""Our client at a plant's server of another stack: node-opcua."""

import pytest

from support import node_peer
from support.source_interoperation import SourceInteroperation

pytestmark = [pytest.mark.node, pytest.mark.asyncio(loop_scope="module")]


@pytest.fixture(scope="module")
def program(request):
    return node_peer.program(request.config.cache.mkdir("node_peer"), "server.cjs")


class TestSourceNodeOpcua(SourceInteroperation):
    """The list that every stack goes through."""
