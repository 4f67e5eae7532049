"""The pictures of the page for README and docs: ``python -m benchmarks.page_pictures``.

Needs a demo that runs, and Chromium (Debian: ``apt-get install chromium``).
"""

import asyncio
import shutil
import sys
from pathlib import Path

from playwright.async_api import Page, async_playwright

URL = "http://127.0.0.1:8080"
DOCS = Path(__file__).parents[1] / "docs"
_GRAPHICS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
_LOOK_S = {"valve": 60.0, "map": 12.0, "commissioning": 4.0}  # until there is something to see
_THEMES = {"light": ("valve", "map", "commissioning"), "dark": ("map",)}


def main() -> None:
    """Look at each view, and keep what is seen."""
    url = sys.argv[1] if len(sys.argv) > 1 else URL
    asyncio.run(_draw(url, shutil.which("chromium") or "chromium"))


async def _draw(url: str, program: str) -> None:
    async with async_playwright() as driver:
        browser = await driver.chromium.launch(
            executable_path=program, args=["--no-sandbox", *_GRAPHICS]
        )
        for theme, views in _THEMES.items():
            view = {"width": 1280, "height": 800}
            context = await browser.new_context(viewport=view, color_scheme=theme)  # type: ignore[arg-type]
            page = await context.new_page()
            for name in views:
                picture = DOCS / f"page_{name}_{theme}.png"
                await _look(page, f"{url}/#/{name}", _LOOK_S[name], picture)
        await browser.close()


async def _look(page: Page, url: str, look_s: float, picture: Path) -> None:
    await page.goto(url)
    await page.wait_for_timeout(1_000.0 * look_s)
    await page.screenshot(path=picture)


if __name__ == "__main__":
    main()
