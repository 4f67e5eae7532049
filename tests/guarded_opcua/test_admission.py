"""The door stays open: who is known gets in, whoever else holds or guesses what he can."""

import asyncio
import contextlib
import sys
import time

import pytest
import pytest_asyncio
from asyncua import ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256

from guarded_opcua import (
    HardenedServer,
    Limits,
    ManualClock,
    Pki,
    Role,
    ServerSettings,
    UserStore,
    ensure_certificate,
    trust,
)
from guarded_opcua.security.login_queue import LoginQueue
from support import door_attacks
from support.served import patient
from support.users import CHEAP

pytestmark = pytest.mark.asyncio(loop_scope="module")

Codes = ua.StatusCodes
PASSWORD = "correct horse"
DOOR_ATTACKS = door_attacks.__file__
SOON_S = 2.0


class Door:
    def __init__(self, server, own):
        self.server, self.own = server, own

    async def log_in(self, user=None, *, secured=False):
        """Log in and out; return the seconds it took to get in."""
        client = patient(self.server.url)
        client.application_uri = "urn:test:client"
        if secured:
            policy = SecurityPolicyBasic256Sha256
            await client.set_security(policy, str(self.own.certificate), str(self.own.key))
        if user is not None:
            client.set_user(user)
            client.set_password(PASSWORD)
        began = time.perf_counter()
        async with client:
            return time.perf_counter() - began


async def opened(folder, limits):
    pki = Pki(folder / "server")
    own = ensure_certificate(Pki(folder / "client"), "urn:test:client", ("localhost",), "client")
    trust(pki, own.certificate)
    users = UserStore(cost=CHEAP)
    users.add("olga", Role.OPERATOR, PASSWORD)
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/door/",
        application_uri="urn:test:door",
        application_name="door",
        namespace_uri="urn:door",
        pki=pki,
        users=users,
        none_on_loopback=True,
        limits=limits,
    )
    return Door(await HardenedServer.create(settings), own)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def door(tmp_path_factory):
    made = await opened(tmp_path_factory.mktemp("door"), Limits())
    async with made.server:
        yield made


@contextlib.asynccontextmanager
async def attacked(door, *attacks):
    """Let a process of its own attack, at the lowest priority: as if it computed elsewhere."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, DOOR_ATTACKS, door.server.url, *attacks, stdout=asyncio.subprocess.PIPE
    )
    try:
        assert await process.stdout.readline() == b"under way\n"
        yield
    finally:
        process.kill()
        await process.wait()


@pytest.mark.waits
async def test_idle_connections_of_two_addresses_keep_nobody_out(door):
    await door.log_in("olga")
    async with attacked(door, "idle"):
        waits = [await door.log_in("olga", secured=n % 2 == 1) for n in range(16)]
        waits.append(await door.log_in())
    assert max(waits) < SOON_S


@pytest.mark.waits
@pytest.mark.parametrize("same_address", [False, True])
async def test_fifty_guesses_a_second_keep_a_known_user_out_nowhere(door, same_address):
    await door.log_in("olga")
    guesses = "guess_other_names" if same_address else "guess_from_elsewhere"
    async with attacked(door, "idle", guesses):
        waits = [await door.log_in("olga", secured=n % 2 == 1) for n in range(8)]
    assert max(waits) < SOON_S


async def test_a_part_of_all_room_is_kept_for_operators(tmp_path):
    limits = Limits(sessions=20, sessions_per_host=20, subscriptions=20)
    door = await opened(tmp_path, limits)
    async with door.server, contextlib.AsyncExitStack() as stack:

        async def enter(user=None):
            client = patient(door.server.url)
            if user is not None:
                client.set_user(user)
                client.set_password(PASSWORD)
            return await stack.enter_async_context(client)

        observers = [await enter() for _ in range(18)]
        with pytest.raises(ua.UaStatusCodeError) as refused:
            await enter()
        assert refused.value.code == Codes.BadTooManySessions
        for observer in observers:
            await observer.create_subscription(1_000, None)
        with pytest.raises(ua.UaStatusCodeError) as refused:
            await observers[0].create_subscription(1_000, None)
        assert refused.value.code == Codes.BadTooManySubscriptions
        operator = await enter("olga")
        await operator.create_subscription(1_000, None)


class Hashing:
    """Users whose passwords take until they are released."""

    def __init__(self):
        self.asked, self.gates = [], {}

    def knows(self, name, origin):
        return (name, origin) == ("olga", "home")

    def locked(self, name, _origin):
        return name == "locked"

    def authenticate(self, name, _password, origin):
        self.asked.append((name, origin))
        return Role.OPERATOR if name == "olga" else None


async def test_guesses_take_turns_by_address_and_who_is_known_goes_first():
    clock, users = ManualClock(), Hashing()
    queue = LoginQueue(users, clock)
    wanted = [(f"g{n}", "far") for n in range(3)] + [("new", "near"), ("olga", "home")]
    tasks = [asyncio.create_task(queue.authenticate(name, "", at)) for name, at in wanted]
    while not all(task.done() for task in tasks):
        await asyncio.sleep(0.001)
        clock.advance(0.05)
    assert users.asked == [
        ("olga", "home"), ("g0", "far"), ("new", "near"), ("g1", "far"), ("g2", "far"),
    ]  # fmt: skip
    assert [task.result() for task in tasks] == [None] * 4 + [Role.OPERATOR]


async def test_what_an_address_guesses_beyond_a_few_at_a_time_is_refused_unhashed():
    clock, users = ManualClock(), Hashing()
    queue = LoginQueue(users, clock)
    tasks = [asyncio.create_task(queue.authenticate(f"g{n}", "", "far")) for n in range(20)]
    while not all(task.done() for task in tasks):
        await asyncio.sleep(0.001)
        clock.advance(0.05)
    assert len(users.asked) <= 6
    assert queue.refused_unhashed >= 14
