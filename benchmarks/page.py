"""What the live page costs: its memory and CPU, and what its viewers cost the service.

``python -m benchmarks.page`` runs a demo with one and with twenty viewers of a valve at 10 Hz,
three and six times, each between two stretches without any (so that a machine whose pace drifts is
compared with itself), and writes ``benchmarks/results/page.json``. No dynamics are fitted: a fit of
seconds would fall into some stretches only. Eleven minutes.
"""

import asyncio
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import median

from websockets.asyncio.client import connect

from benchmarks import results_file
from valvemap.opcua_client.results_client import ResultsClient
from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.opcua_results.results_server import NAMESPACE

VIEWERS = (*(0, 1, 0, 20, 0, 20) * 3, 0)
SPAN_S = 30.0
YOUNG_S = 60.0
_SETTLE_S = 5.0
_RIG = "opc.tcp://127.0.0.1:4850/valvemap/rig/"
SERVICE = "opc.tcp://127.0.0.1:4851/valvemap/service/"
_NO_DYNAMICS = {"VALVEMAP_DYNAMICS__SHARE": "0"}
_WATCH = json.dumps({"watch": {"valve": "Valvistor", "estimator": None, "overview": True}})


def main() -> None:
    """Measure, print, write."""
    found = figures()
    for name, value in found.items():
        print(f"{name:45s} {value:10.1f}")
    results_file.keep(Path(__file__).parent / "results" / "page.json", found)


def figures() -> dict[str, float]:
    """Processor time of the page, and of the service for it."""
    bare = _bare_asyncua_mb()
    with (
        tempfile.TemporaryDirectory() as folder,
        demo(Path(folder) / "demo.log", _NO_DYNAMICS) as (pid, log),
    ):
        found = asyncio.run(_measure(pid, log))
    found["bare asyncua import, MB"] = bare
    found["page above a bare asyncua import, MB"] = found["page, MB, with 20 viewers"] - bare
    return found


@contextmanager
def demo(log: Path, environment: Mapping[str, str] | None = None) -> Iterator[tuple[int, Path]]:
    """Run a demo; its process id, and its log."""
    env = {"VALVEMAP_SOURCE__URL": _RIG, "VALVEMAP_SERVER__URL": SERVICE, **(environment or {})}
    with log.open("wb") as out:
        process = subprocess.Popen(
            [sys.executable, "-u", "-m", "valvemap", "demo"],
            stdout=out,
            env={**os.environ, **env, "VALVEMAP_PAGE_LISTEN": "127.0.0.1:0"},
        )
    try:
        yield process.pid, log
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()


async def _measure(pid: int, log: Path) -> dict[str, float]:
    url = await page_url(log)
    page = child(pid, "dashboard")
    await asyncio.sleep(YOUNG_S)
    stretches = [await _with(viewers, url, pid, page) for viewers in VIEWERS]
    found: dict[str, float] = {}
    for viewers in sorted(set(VIEWERS)):
        alike = [s for n, s in zip(VIEWERS, stretches, strict=True) if n == viewers]
        for k, what in enumerate(("service, % of a core", "page, % of a core", "page, MB")):
            found[f"{what}, with {viewers} viewers"] = median(s[k] for s in alike)
        if viewers:
            found[f"service, {viewers} viewers against none, %"] = _more(viewers, stretches)
    client = ResultsClient(SourceSettings(url=SERVICE), NAMESPACE)
    await client.connect()
    (gaps,) = await client.read(["Valvistor.Diagnostics.Gaps"])
    found["samples lost"] = float(gaps.value)
    await client.close()
    return found


def _more(viewers: int, stretches: Sequence[tuple[float, float, float]]) -> float:
    """How much more the service takes with viewers than just before and after without, in %."""
    service = [stretch[0] for stretch in stretches]
    return 100.0 * median(
        2.0 * service[k] / (service[k - 1] + service[k + 1]) - 1.0
        for k, n in enumerate(VIEWERS)
        if n == viewers
    )


async def _with(viewers: int, url: str, service: int, page: int) -> tuple[float, float, float]:
    """Service and page in % of a core, memory of the page in MB."""
    watching = [asyncio.create_task(_watch(url)) for _ in range(viewers)]
    await asyncio.sleep(_SETTLE_S)
    before = cpu_s(service), cpu_s(page)
    await asyncio.sleep(SPAN_S)
    after = cpu_s(service), cpu_s(page)
    memory = _rss_mb(page)
    for task in watching:
        task.cancel()
    await asyncio.gather(*watching, return_exceptions=True)
    of_service, of_page = (100.0 * (b - a) / SPAN_S for a, b in zip(before, after, strict=True))
    print(
        f"{viewers} viewers: service {of_service:.2f}, page {of_page:.2f} % of a core", flush=True
    )
    return of_service, of_page, memory


async def _watch(url: str) -> None:
    live = url.replace("http", "ws") + "/live"
    async with connect(live, origin=url, proxy=None) as socket:  # type: ignore[arg-type]
        await socket.send(_WATCH)
        async for _ in socket:
            pass


async def page_url(log: Path) -> str:
    """Wait for a demo's page; its URL."""
    for _ in range(1_500):  # the very first start compiles
        if url := _said(log, "page"):
            return url
        await asyncio.sleep(0.2)
    raise TimeoutError(str(log))


def _said(log: Path, what: str) -> str | None:
    lines = log.read_text(encoding="utf-8").splitlines()
    return next((line.split()[-1] for line in lines if line.startswith(what)), None)


def child(parent: int, command: str) -> int:
    """Process id of the child with this word in its command line."""
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            words = (entry / "cmdline").read_bytes().split(b"\0")
            stat = (entry / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(stat[1]) == parent and command.encode() in words:
            return int(entry.name)
    raise RuntimeError(f"no {command} below {parent}")


def cpu_s(pid: int, thread: str | None = None) -> float:
    """Seconds of a core that a process has used, or one of its threads."""
    whose = f"{pid}" if thread is None else f"{pid}/task/{thread}"
    stat = Path(f"/proc/{whose}/stat").read_text().rpartition(")")[2].split()
    return (int(stat[11]) + int(stat[12])) / os.sysconf("SC_CLK_TCK")


def _rss_mb(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def _bare_asyncua_mb() -> float:
    program = (
        "import asyncua, os; print(int(open('/proc/self/statm').read().split()[1])"
        " * os.sysconf('SC_PAGE_SIZE') / 1e6)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True)
    return float(done.stdout)


if __name__ == "__main__":
    main()
