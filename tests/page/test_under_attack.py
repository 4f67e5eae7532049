"""Whatever one host does, the page answers others, lets the operator in, and ends when asked."""

import asyncio
import contextlib
import os
import signal
import sys
import time
from pathlib import Path

import pytest
from cryptography.hazmat.primitives import serialization

from support import certificates, page_attacks
from support.page_attacks import Visitor

ATTACKS = Path(page_attacks.__file__)
PAGE = ATTACKS.with_name("page_process.py")
HOSTS, OPERATOR = [f"127.0.0.{number}" for number in range(2, 7)], "127.0.0.9"
SOON_S, LOG_IN_S, FAREWELL_S, DESCRIPTORS = 2.0, 5.0, 5.0, 200
GETS = 14

pytestmark = [pytest.mark.waits, pytest.mark.timeout(900)]  # 100 s alone


class PageProcess:
    """The page in a separate process."""

    def __init__(self, process):
        self.process = process

    @property
    def mib(self):
        """Resident memory."""
        pages = Path(f"/proc/{self.process.pid}/statm").read_text().split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE") / 1_048_576

    async def watch_descriptors(self):
        """Return the most descriptors that are open at once, once cancelled."""
        most = 0
        with contextlib.suppress(asyncio.CancelledError):
            while True:
                most = max(most, len(list(os.scandir(f"/proc/{self.process.pid}/fd"))))
                await asyncio.sleep(0.02)
        return most

    async def end(self):
        """End it; return the seconds that took."""
        began = time.perf_counter()
        self.process.send_signal(signal.SIGTERM)
        assert await asyncio.wait_for(self.process.wait(), 30) == 0
        return time.perf_counter() - began


@contextlib.asynccontextmanager
async def started(*arguments):
    """Run a program of ours; yield it and its first line."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, *arguments, stdout=asyncio.subprocess.PIPE
    )
    try:
        yield process, (await process.stdout.readline()).decode().strip()
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


async def seconds(doing):
    began = time.perf_counter()
    result = await doing
    return time.perf_counter() - began, result


@pytest.fixture
def encrypted(tmp_path):
    """Certificate and key of the page."""
    made = certificates.self_signed()
    files = tmp_path / "page.pem", tmp_path / "page.key"
    pem = serialization.Encoding.PEM
    files[0].write_bytes(made.certificate.public_bytes(pem))
    form, plain = serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    files[1].write_bytes(made.key.private_bytes(pem, form, plain))
    return files


async def holds_against(attack, hosts, *files, mib=32.0):
    """Measure what an attack costs others; assert every bar."""
    async with started(PAGE, *files) as (process, url):
        page, operator = PageProcess(process), Visitor(url, OPERATOR)
        assert await operator.get() == 200
        await operator.see()
        before = page.mib
        watching = asyncio.create_task(page.watch_descriptors())
        async with started(ATTACKS, url, attack, *hosts) as (attacker, said):
            assert said == "under way"
            found = [await seconds(operator.get()) for _ in range(GETS)]
            view_s, _ = await seconds(operator.see())
            log_in_s, status = await seconds(operator.log_in())
            assert attacker.returncode is None
            more_mib = page.mib - before
            watching.cancel()
            descriptors = await watching
            end_s = await page.end()
    get_s = max(wait for wait, _ in found)
    print(  # noqa: T201 - for the table of docs/hostile.md
        f"| `{attack}` | {len(hosts)} | {get_s:.2f} | {view_s:.2f} | {log_in_s:.2f} "
        f"| {descriptors} | {more_mib:.1f} | {end_s:.1f} |"
    )
    assert [answer for _, answer in found] == GETS * [200]
    assert status == 200
    assert get_s <= SOON_S
    assert view_s <= SOON_S
    assert log_in_s <= LOG_IN_S
    assert descriptors <= DESCRIPTORS
    assert more_mib <= mib
    assert end_s <= FAREWELL_S


@pytest.mark.parametrize("attack", [attack.__name__ for attack in page_attacks.PLAIN[:4]])
async def test_the_page_holds(attack):
    await holds_against(attack, HOSTS[:1])


@pytest.mark.soak
@pytest.mark.parametrize("attack", [attack.__name__ for attack in page_attacks.PLAIN[4:]])
async def test_the_page_holds_against_what_is_part_of_the_next_test(attack):
    await holds_against(attack, HOSTS[:1])


async def test_the_page_holds_against_all_of_it_from_five_hosts():
    await holds_against("do_all", HOSTS)


async def test_the_encrypted_page_holds_against_handshakes_that_never_start(encrypted):
    await holds_against("start_no_handshake", HOSTS, *encrypted)


@pytest.mark.soak
async def test_the_encrypted_page_holds_against_handshakes_that_stop_half_way(encrypted):
    await holds_against("stop_in_the_handshake", HOSTS, *encrypted, mib=96.0)
