"""Time to a trend of seven days, and its processor time: ``python -m benchmarks.page_trend``.

A history of seven days of six signals at 10 Hz, with the results of an estimator, is made and given
to a demo, whose valve of 100 Hz is identified too. Once the service has checked the file,
Chromium opens the trend: the first picture with nothing read before; zooms, until the picture
follows and until the finer intervals are there. Then stretches with and without an open trend of
seven days, in turns: what the service takes of a core. Searches that start now and then in threads
of their own (the dynamics of a valve: seven seconds of a core in 90 s) are left out, since they
fall into either kind of stretch by chance. Ten minutes.
"""

import asyncio
import shutil
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from statistics import median

import numpy as np
from playwright.async_api import Page, async_playwright

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from benchmarks import results_file
from benchmarks.page import SERVICE, child, cpu_s, demo, page_url
from valvemap.errors import SourceLost
from valvemap.opcua_client.results_client import ResultsClient
from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.opcua_results.results_server import NAMESPACE
from valvemap.pipeline.store_ports import Piece
from valvemap.storage.history import HistoryFile
from valvemap.vocabulary.quantities import HISTORY_QUANTITIES
from valvemap.vocabulary.signals import PUBLISHED

VALVE = "Valvistor"
DAYS, HZ = 7, 10
ROWS_AT_ONCE = 20_000
CHECKED_S = 900.0  # the service checks a file of this size, and reads no summaries until then
_QUICK_S = 0.3  # a course of seven days from summaries; from all values it takes seconds
_AGAIN_S = 15.0
_SEEN_S = 300.0  # time that a busy machine may need
ROUNDS = 5  # stretches with a trend, each between two without
STRETCH_S = 30.0
ZOOMS = 8
_S = 1_000_000_000
_WEEK_S = DAYS * 86_400
_OPENED = """hash => new Promise(done => {
    const begun = performance.now(), view = document.querySelector('main');
    location.hash = hash;
    const look = () => {
        if (view.dataset.view === 'trend' && view.dataset.reading === 'false') {
            requestAnimationFrame(() => setTimeout(() => done(performance.now() - begun)));
        } else setTimeout(look, 2);
    };
    setTimeout(look);
})"""
_ZOOMED = """key => new Promise(done => {
    const begun = performance.now(), view = document.querySelector('main');
    let seen = 0;
    document.dispatchEvent(new KeyboardEvent('keydown', { key }));
    requestAnimationFrame(() => setTimeout(() => { seen = performance.now() - begun; }));
    let began = false;
    const look = () => {
        began = began || view.dataset.reading === 'true';
        if (seen && began && view.dataset.reading === 'false') {
            requestAnimationFrame(() => setTimeout(() => done([seen, performance.now() - begun])));
        } else setTimeout(look, 2);
    };
    look();
})"""


def main() -> None:
    """Measure, print, write."""
    found = figures()
    for name, value in found.items():
        print(f"{name:58s} {value:10.1f}")
    results_file.keep(Path(__file__).parent / "results" / "page_trend.json", found)


def figures() -> dict[str, float]:
    """Milliseconds until pictures are there; what an open trend costs the service."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        kept = folder / "history.sqlite"
        make_week(kept, time.time_ns() // _S - _WEEK_S)
        environment = {"VALVEMAP_HISTORY__FILE": str(kept)}
        with demo(folder / "demo.log", environment) as (pid, log):
            return asyncio.run(_measure(pid, log))


def make_week(path: Path, start_s: int) -> None:
    """Save seven days of signals and results: a working cycle with noise."""
    rng = np.random.default_rng(0)
    names = [quantity.name for quantity in HISTORY_QUANTITIES]
    with HistoryFile(path) as store:
        for first in range(0, _WEEK_S * HZ, ROWS_AT_ONCE):
            k = np.arange(first, first + ROWS_AT_ONCE)
            t, good = start_s * _S + k * (_S // HZ), np.zeros(len(k), np.uint32)
            cycle = 50.0 + 40.0 * np.sin(2.0 * np.pi * k / (HZ * 60.0))
            noise = rng.normal(size=(len(PUBLISHED) + len(names), len(k))).round(2)
            signals = {name: cycle + noise[j] for j, name in enumerate(PUBLISHED)}
            results = {name: cycle + noise[len(PUBLISHED) + j] for j, name in enumerate(names)}
            store.save(
                [
                    Piece(f"{VALVE}.Signals", t, good, signals),
                    Piece(f"{VALVE}.Auto", t, good, results),
                ]
            )


async def _measure(pid: int, log: Path) -> dict[str, float]:
    url = await page_url(log)
    async with async_playwright() as driver:
        browser = await driver.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        page = await browser.new_page(viewport={"width": 1280, "height": 800})
        page.set_default_timeout(1_000.0 * _SEEN_S)
        await page.add_init_script("localStorage.setItem('tour', 'closed')")
        await page.goto(f"{url}/#/overview")
        await page.locator(".rows a", has_text=VALVE).wait_for()
        await _until_checked()
        server = child(pid, "dashboard")
        found = await _pictures(page, (pid, server))
        found |= await _cost(page, url, pid, server)
        await browser.close()
    return found


async def _until_checked() -> None:
    """Wait until the service reads trends from its summaries."""
    interval = 600 * _S
    end = time.time_ns() // interval * interval
    asked, span = [(f"{VALVE}.Signals.Q", "Average")], (end - _WEEK_S * _S, end)
    async with asyncio.timeout(CHECKED_S):
        while True:
            client = ResultsClient(SourceSettings(url=SERVICE), NAMESPACE)
            try:
                await client.connect()
                began = time.perf_counter()
                await client.courses(asked, span, interval)
                if time.perf_counter() - began < _QUICK_S:
                    return
            except SourceLost:
                pass  # it took longer than a client waits
            finally:
                await client.close()
            await asyncio.sleep(_AGAIN_S)


async def _pictures(page: Page, processes: tuple[int, int]) -> dict[str, float]:
    """Time of each picture; the processor time of both processes is printed too."""
    trend = f"#/trend/{VALVE}?span={_WEEK_S}"
    first = await page.evaluate(_OPENED, trend)
    print(f"{'span, h':>8} {'read, ms':>9} {'CPU of the service, of the page, ms':>36}")
    seen, finer = [], []
    for zoom in range(1, ZOOMS + 1):
        before = [cpu_s(process) for process in processes]
        picture, read = await page.evaluate(_ZOOMED, "+")
        took = [1_000.0 * (cpu_s(p) - b) for p, b in zip(processes, before, strict=True)]
        print(
            f"{_WEEK_S / 2**zoom / 3_600:8.1f} {read:9.0f} {took[0]:18.0f} {took[1]:17.0f}",
            flush=True,
        )
        seen.append(picture)
        finer.append(read)
        await page.wait_for_timeout(1_000)
    return {
        "first picture of seven days, ms (bar 1000)": first,
        "zoom: the picture follows, ms (bar 200)": median(seen),
        "zoom: the slowest, ms": max(seen),
        "zoom: finer intervals are there, ms": median(finer),
        "zoom: the slowest finer intervals, ms": max(finer),
    }


async def _cost(page: Page, url: str, service: int, server: int) -> dict[str, float]:
    """Compare stretches with an open trend of seven days with those before and after."""
    threads, of_page = [], []
    for k in range(2 * ROUNDS + 1):
        await page.goto("about:blank")
        if k % 2:
            await page.goto(f"{url}/#/trend/{VALVE}?span={_WEEK_S}")
            await page.locator("main[data-reading=false]").wait_for()
        await asyncio.sleep(2.0)
        began, page_s = _threads_s(service), cpu_s(server)
        await asyncio.sleep(STRETCH_S)
        threads.append((began, _threads_s(service)))
        of_page.append(100.0 * (cpu_s(server) - page_s) / STRETCH_S)
    lasting = threads[-1][1].keys() & threads[-2][1].keys()
    of_service = [
        100.0 * sum(ended.get(one, 0.0) - began.get(one, 0.0) for one in lasting) / STRETCH_S
        for began, ended in threads
    ]
    print("service, % of a core, without and with a trend in turns:", np.round(of_service, 2))
    more = [
        of_service[k] - (of_service[k - 1] + of_service[k + 1]) / 2.0
        for k in range(1, len(threads), 2)
    ]
    return {
        "service without a trend, % of a core": median(of_service[::2]),
        "service with one, more, % of a core (bar 2)": median(more),
        "page with one, % of a core": median(of_page[1::2]),
    }


def _threads_s(pid: int) -> dict[str, float]:
    """Seconds of a core by thread."""
    found = {}
    for task in Path(f"/proc/{pid}/task").iterdir():
        with suppress(OSError):  # it has ended
            found[task.name] = cpu_s(pid, task.name)
    return found


if __name__ == "__main__":
    main()
