"""Eclipse Milo as a client at our results server."""

import pytest

from support import milo_peer
from support.interoperation import ClientInteroperation
from support.scada_interoperation import ScadaInteroperation

pytestmark = [pytest.mark.milo, pytest.mark.asyncio(loop_scope="module")]


@pytest.fixture(scope="module")
def program(request):
    return milo_peer.program(request.config.cache.mkdir("milo_client"))


class TestMilo(ClientInteroperation):
    """The list that every stack goes through."""


class TestMiloAsScada(ScadaInteroperation):
    """Types, alarms and trends."""
