"""A visitor's first minutes with the demo: ``python -m benchmarks.first_minutes``.

Follows the tour as one who knows nothing would, breaks the valve, and prints what the page says at
each step, and after how many seconds: the transcript of docs/first_minutes.md. Needs Chromium. A
few minutes, most of them the demo's start.
"""

import asyncio
import re
import shutil
import time
from dataclasses import dataclass, field

from playwright.async_api import Page, TimeoutError, async_playwright  # noqa: A004 - its own

from benchmarks.page_pictures import DESK, GRAPHICS, demo

_LINES = 14  # of a view are printed
_WAITS_MS = 120_000.0
_WATCHES_S = 30.0  # how long the visitor watches it learn


@dataclass
class Visit:
    """One visitor's page, and when it was opened."""

    page: Page
    began: float = field(default_factory=time.monotonic)

    async def does(self, what: str) -> None:
        """Print what the visitor does."""
        print(f"\n{time.monotonic() - self.began:5.1f} s  {what}", flush=True)

    async def reads(self, selector: str, most: int = _LINES) -> None:
        """Print what stands there."""
        text = await self.page.locator(selector).first.inner_text()
        lines = [line for line in re.split(r"\s*\n\s*", text.strip()) if line]
        for line in lines[:most]:
            print(f"         | {line}", flush=True)

    async def waits(self, selector: str, text: str) -> float:
        """Wait for a text; return the seconds that it took. If it does not come, print the view."""
        began = time.monotonic()
        found = self.page.locator(selector, has_text=re.compile(text)).first
        try:
            await found.wait_for(timeout=_WAITS_MS)
        except TimeoutError:
            await self.does(f"waits in vain for “{text}”")
            await self.reads("body", 60)
            raise
        return time.monotonic() - began

    async def tour(self, button: str) -> None:
        """Press a button of the tour."""
        await self.page.locator("aside.tour button", has_text=button).click()


def main() -> None:
    """Visit a demo."""
    asyncio.run(_visit(shutil.which("chromium") or "chromium"))


async def _visit(program: str) -> None:
    async with demo() as (url, password), async_playwright() as driver:
        browser = await driver.chromium.launch(
            executable_path=program, args=["--no-sandbox", *GRAPHICS]
        )
        width, height = DESK
        visit = Visit(await browser.new_page(viewport={"width": width, "height": height}))
        page = visit.page
        page.on("pageerror", lambda error: print(f"         ! {error}", flush=True))
        await page.goto(url)
        await visit.waits(".link-text", "Connected")
        await visit.does("opens the page")
        await visit.reads("aside.tour")
        await visit.tour("Show me")
        took = await visit.waits("main", r"95 %: [\d.]+ to")
        await visit.does(f"presses “Show me”: the map, drawn after {took:.1f} s")
        await page.wait_for_timeout(1_000.0 * _WATCHES_S)
        await visit.reads("main")
        await visit.tour("Next")
        await visit.does("has watched for half a minute, and presses “Next”")
        await visit.reads("aside.tour")
        await _log_in(page, password)
        await visit.does("logs in as operator, with the demo's password, and presses “Inject”")
        await page.locator("button:not([disabled])", has_text="Inject").click()
        injected = time.monotonic()
        await visit.waits("p[role=status]", "Injected")
        await visit.reads("p[role=status]")
        await visit.waits("main .events", "Changed raised")
        alarm = time.monotonic() - injected
        await visit.does(f"reads of an alarm {alarm:.1f} s after “Inject”, and presses “Next”")
        await visit.tour("Next")
        await visit.waits(".alarm-detail", "Changed")
        await visit.reads(".alarm-detail")
        await page.locator("main").get_by_text("Trend at that time").click()
        took = await visit.waits("main .head", "from the service's history")
        await visit.does(f"presses “Trend at that time”: read after {took:.1f} s")
        await page.wait_for_timeout(3_000)
        await visit.reads("main ol.marks")
        print(f"         | {await page.locator('canvas.lanes').get_attribute('aria-label')}")
        await page.go_back()
        await visit.waits(".alarm-detail", "Changed")
        await page.locator("main").get_by_text("Place in the map").click()
        took = await visit.waits("main", "the valve worked at")
        await visit.does(f"goes back and presses “Place in the map”: shown after {took:.1f} s")
        await visit.reads("main", 30)
        await browser.close()


async def _log_in(page: Page, password: str) -> None:
    await page.locator("button.user").click()
    await page.locator("dialog input[name=user]").fill("operator")
    await page.locator("dialog input[name=password]").fill(password)
    await page.keyboard.press("Enter")
    await page.locator("button.user", has_text="operator").wait_for(timeout=120_000)


if __name__ == "__main__":
    main()
