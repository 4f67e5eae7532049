"""The pictures of the page for README and docs: ``python -m benchmarks.page_pictures``.

Starts a demo of three valves, breaks something of one and draws every view. Needs Chromium
(Debian: ``apt-get install chromium``). Nine minutes.
"""

import asyncio
import re
import shutil
import sys
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from playwright.async_api import Browser, Page, async_playwright

DOCS = Path(__file__).parents[1] / "docs"
GRAPHICS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
DESK, _TABLET = (1280, 800), (820, 1180)
_STARTS_S = 400.0  # the first start of all compiles
_SEEN_S = 600.0  # time that a busy machine may need
_SCENARIO = """
name = "pictures"
valves = [{ name = "Boom" }, { name = "Arm" }, { name = "Bucket" }]
[excitation]
kind = "scattered"
hold_s = 0.4
"""


@dataclass(frozen=True)
class Picture:
    """One to be drawn: its view, what has to be seen there, and how long to look then."""

    name: str
    view: str
    seen: str  # a regular expression
    look_s: float = 2.0
    theme: str = "light"
    size: tuple[int, int] = DESK

    @property
    def file(self) -> Path:
        return DOCS / f"page_{self.name}_{self.theme}.png"


_RESIDUALS = r"[1-9]\d\d residuals"
_ANSWERED = r"95 %: [\d.]+ to"
_MISSING = "Red: the map.*samples learnt from"
PICTURES = (
    # the maps settle before a part is broken
    Picture("commissioning", "commissioning/Boom", _MISSING, look_s=300.0),
    Picture("rig", "rig/Arm", "Injected", look_s=12.0),
    Picture("overview", "overview", "valve changed"),
    Picture("timeline", "timeline", "found an abrupt change"),
    Picture("alarms", "alarms?alarm=Arm%2FChanged", "What to do", look_s=20.0),
    Picture("trend", "trend/Arm?span=300", "from the service's history", look_s=15.0),
    Picture("map", "map/Boom", _ANSWERED, look_s=10.0),
    Picture("map", "map/Boom", _ANSWERED, look_s=10.0, theme="dark"),
    Picture("valve_tablet", "valve/Boom", _RESIDUALS, look_s=40.0, theme="dark", size=_TABLET),
    Picture("valve", "valve/Boom", _RESIDUALS, look_s=40.0),
)


def main() -> None:
    """Open each view, and save its picture."""
    asyncio.run(_draw(shutil.which("chromium") or "chromium"))


async def _draw(program: str) -> None:
    async with demo(_SCENARIO) as (url, password), async_playwright() as driver:
        browser = await driver.chromium.launch(
            executable_path=program, args=["--no-sandbox", *GRAPHICS]
        )
        pages: dict[tuple[str, tuple[int, int]], Page] = {}
        for picture in PICTURES:
            seen_as = (picture.theme, picture.size)
            if seen_as not in pages:
                pages[seen_as] = await _page(browser, picture)
            page = pages[seen_as]
            await page.goto(f"{url}/#/{picture.view}")
            if picture.name == "rig":
                await _break_something(page, password)
            seen = page.locator("main", has_text=re.compile(picture.seen, re.DOTALL))
            await seen.wait_for()
            await page.wait_for_timeout(1_000.0 * picture.look_s)
            await page.locator(".strip").wait_for(state="hidden")
            await page.screenshot(path=picture.file)
            print(picture.file, flush=True)
        await browser.close()


async def _page(browser: Browser, picture: Picture) -> Page:
    width, height = picture.size
    context = await browser.new_context(
        viewport={"width": width, "height": height},
        color_scheme=picture.theme,  # type: ignore[arg-type]
    )
    context.set_default_timeout(1_000.0 * _SEEN_S)
    await context.add_init_script("localStorage.setItem('tour', 'closed')")
    return await context.new_page()


async def _break_something(page: Page, password: str) -> None:
    """As the demo's operator."""
    await page.locator("button.user").click()
    await page.locator("dialog input[name=user]").fill("operator")
    await page.locator("dialog input[name=password]").fill(password)
    await page.keyboard.press("Enter")
    await page.locator("button.user", has_text="operator").wait_for()
    await page.locator("select[name=kind]").select_option("damage")
    await page.locator("input[name=size]").fill("-20")
    await page.locator("input[name=duration]").fill("0")
    await page.get_by_role("button", name="Inject").click()
    await page.locator("p[role=status]", has_text="Injected").wait_for()


@asynccontextmanager
async def demo(scenario=None):
    """A demo, or one of a scenario in TOML: (page's URL, operator's password)."""
    with TemporaryDirectory() as folder:
        options = []
        if scenario is not None:
            file = Path(folder) / "pictures.toml"
            file.write_text(scenario, encoding="utf-8")
            options = ["--scenario", str(file)]
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-u", "-m", "valvemap", "demo", *options),
            stdout=asyncio.subprocess.PIPE,
        )
        try:
            async with asyncio.timeout(_STARTS_S):
                url = await _word(process.stdout, "page")
                password = await _word(process.stdout, "operator")
                await _word(process.stdout, "Arm:" if scenario else "Valvistor:")
            reading = asyncio.create_task(process.stdout.read())
            yield url, password
            reading.cancel()
        finally:
            process.terminate()
            await process.wait()


async def _word(lines: asyncio.StreamReader, first: str) -> str:
    """The last word of the line that begins so."""
    while line := (await lines.readline()).decode():
        if line.startswith(first):
            return line.split()[-1]
    raise RuntimeError(f"the demo ended before it said {first!r}")


if __name__ == "__main__":
    main()
