"""Our client at a plant's server of another stack: o6 over open62541."""

import importlib.util
import sys
from pathlib import Path

import pytest

from support.source_interoperation import SourceInteroperation

pytestmark = pytest.mark.asyncio(loop_scope="module")

_PROGRAM = Path(__file__).parents[1] / "support" / "o6_server.py"


@pytest.fixture(scope="module")
def program():
    if importlib.util.find_spec("o6") is None:
        pytest.skip("o6 is not installed")
    return sys.executable, _PROGRAM


class TestSourceO6(SourceInteroperation):
    """The list that every stack goes through."""
