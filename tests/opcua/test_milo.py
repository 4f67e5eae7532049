"""Eclipse Milo as a client at our results server."""

from pathlib import Path

import pytest

from support import maven_peer
from support.interoperation import ClientInteroperation
from support.scada_interoperation import ScadaInteroperation

pytestmark = [pytest.mark.milo, pytest.mark.asyncio(loop_scope="module")]


@pytest.fixture(scope="module")
def program(request):
    folder = Path(__file__).parent / "milo_client"
    return maven_peer.program(folder, "valvemap.Client", request.config.cache.mkdir("milo_client"))


class TestMilo(ClientInteroperation):
    """The list that every stack goes through."""


class TestMiloAsScada(ScadaInteroperation):
    """Types, alarms and trends."""
