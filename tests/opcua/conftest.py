"""What the tests with programs of other stacks share; each module says which ``program`` it is."""

import pytest_asyncio

from support.interoperation import Asking, raised
from support.peer import Peer
from support.source_interoperation import planted


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def stage(tmp_path_factory):
    async with raised(tmp_path_factory.mktemp("stage")) as stage:
        yield stage


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def peer(program):
    peer = await Peer.start(*program)
    yield peer
    await peer.stop()


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def operator(peer, stage):
    operator = Asking(peer, "operator")
    await operator.ask("connect", **stage.who())
    yield operator
    await operator.ask("disconnect")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def observer(peer, stage):
    observer = Asking(peer, "observer")
    await observer.ask("connect", **stage.who("observer"))
    yield observer
    await observer.ask("disconnect")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def plant(program, tmp_path_factory):
    async with planted(tmp_path_factory.mktemp("plant"), program) as plant:
        yield plant
