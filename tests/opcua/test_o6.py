"""o6, a client over open62541, at our results server."""

import importlib.util
import sys
from pathlib import Path

import pytest

from support.interoperation import ClientInteroperation
from support.scada_interoperation import ScadaInteroperation

pytestmark = [pytest.mark.waits, pytest.mark.asyncio(loop_scope="module")]

_PROGRAM = Path(__file__).parents[1] / "support" / "o6_client.py"


@pytest.fixture(scope="module")
def program():
    if importlib.util.find_spec("o6") is None:
        pytest.skip("o6 is not installed")
    return sys.executable, _PROGRAM


class TestO6(ClientInteroperation):
    """The list that every stack goes through."""

    asks_again = False  # open62541's client does not know Republish


class TestO6AsScada(ScadaInteroperation):
    """Types, alarms and trends."""
