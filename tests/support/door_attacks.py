"""Attacks on the door of a server: ``python door_attacks.py URL NAME...``, until it is killed."""

import asyncio
import contextlib
import itertools
import os
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from asyncua import ua
from asyncua.crypto import uacrypto
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256, encrypt_asymmetric
from asyncua.ua import ua_binary

from support.raw_peer import RawPeer

OTHERS = [f"127.0.0.{number}" for number in range(2, 12)]
IDLE_OF_ADDRESS, GUESSES_PER_S = 50, 50.0


async def idle(url):
    """Hold fifty connections of two addresses each that never say hello."""
    await asyncio.gather(*(hold(url, source) for source in OTHERS[:2]))


async def hold(url, source):
    held = []
    while True:
        held = [peer for peer in held if not peer.reader.at_eof()]
        while len(held) < IDLE_OF_ADDRESS:
            held.append(await RawPeer.connect(url, source))
            await asyncio.sleep(0.02)
        await asyncio.sleep(0.05)


async def guess_other_names(url):
    """Guess at names that nobody has, from the address of everybody."""
    await guess_on(url, itertools.repeat(None), (f"nobody {n}" for n in itertools.count()))


async def guess_from_elsewhere(url):
    """Guess at a user's name from ten other addresses."""
    await guess_on(url, itertools.cycle(OTHERS), itertools.repeat("olga"))


async def guess_on(url, sources, names):
    due, under_way = time.monotonic(), set()
    for source, name in zip(sources, names, strict=False):
        under_way.add(task := asyncio.create_task(guess(url, source, name)))
        task.add_done_callback(under_way.discard)
        due += 1.0 / GUESSES_PER_S
        await asyncio.sleep(max(0.0, due - time.monotonic()))


async def guess(url, source, name):
    with contextlib.suppress(Exception):
        peer = await RawPeer.connect(url, source)
        try:
            await peer.open()
            made = await peer.create_session()
            key = uacrypto.x509_from_der(made.ServerCertificate).public_key()
            secret = ua_binary.Primitives.Bytes.pack(b"a wrong guess" + made.ServerNonce)
            token = ua.UserNameIdentityToken("username", name, b"", None)
            token.Password, token.EncryptionAlgorithm = encrypt_asymmetric(
                key, secret, SecurityPolicyBasic256Sha256.URI
            )
            await peer.activate(token)
        finally:
            peer.close()


async def main(url, *names):
    attacks = {f.__name__: f for f in (idle, guess_other_names, guess_from_elsewhere)}
    running = asyncio.gather(*(attacks[name](url) for name in names))
    await asyncio.sleep(3.0)
    sys.stdout.write("under way\n")
    sys.stdout.flush()
    await running


if __name__ == "__main__":
    os.nice(19)
    asyncio.run(main(*sys.argv[1:]))
