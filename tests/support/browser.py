"""Chromium for tests of the page: Debian's, driven by Playwright; skipped where there is none."""

import shutil
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from support.node_peer import installed

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
_ARGUMENTS = (
    "--no-sandbox",  # the tests may run as root
    "--use-angle=swiftshader",  # WebGL without a graphics card
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-gpu-compositing",  # without a graphics card WebGL alone needs the emulated one
    "--disable-gpu-rasterization",
)

_VIOLATIONS = """() => axe.run({ resultTypes: ['violations'] }).then(({ violations }) =>
    violations.map(({ impact, id, nodes: [{ html, failureSummary }] }) =>
        [impact, id, html.slice(0, 200), failureSummary.slice(0, 300)]))"""


@asynccontextmanager
async def chromium():
    """A browser."""
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        pytest.skip("Chromium is not installed (Debian: apt-get install chromium)")
    playwright = pytest.importorskip("playwright.async_api")
    async with playwright.async_playwright() as driver:
        browser = await driver.chromium.launch(executable_path=program, args=list(_ARGUMENTS))
        try:
            yield browser
        finally:
            await browser.close()


@asynccontextmanager
async def tab(browser, url, password=None, size=(1280, 800), **given):
    """A visit in a context of its own, which is closed at the end, also of a test that fails."""
    viewport = dict(zip(("width", "height"), size, strict=True))
    async with await browser.new_context(viewport=viewport, **given) as context:
        yield Visit(await context.new_page(), url, password)


class Visit:
    """A page that is looked at; everything that went wrong in it is kept in ``problems``."""

    def __init__(self, page, url, password=None):
        self.page, self.url, self.password = page, url, password
        self.problems = []
        self.bytes = {}
        page.on("console", self._console)
        page.on("pageerror", lambda error: self.problems.append(f"error: {error}"))
        page.on("request", self._request)
        page.on("response", self._response)

    async def open(self, view):
        await self.page.goto(f"{self.url}/#/{view}")

    async def text(self, selector):
        return (await self.page.locator(selector).first.text_content() or "").strip()

    async def until(self, condition):
        """Wait until a JavaScript expression holds.

        Playwright's ``wait_for_function`` evaluates within the page, where its policy forbids it.
        """
        while not await self.page.evaluate(condition):
            await self.page.wait_for_timeout(50)

    async def log_in(self):
        await self.page.locator("button.user").click()
        await self.page.locator("dialog input[name=user]").fill("operator")
        await self.page.locator("dialog input[name=password]").fill(self.password)
        await self.page.keyboard.press("Enter")
        await self.page.locator("button.user", has_text="operator").wait_for()

    def _console(self, message):
        if message.type in {"error", "assert"}:
            self.problems.append(f"console: {message.text}")

    def _request(self, request):
        host = self.url.partition("://")[2]
        own = (f"http://{host}", f"ws://{host}", "data:", "blob:")
        if not request.url.startswith(own):
            self.problems.append(f"foreign: {request.url}")

    def _response(self, response):
        length = response.headers.get("content-length")
        self.bytes[response.url.partition("#")[0]] = int(length or 0)


def axe(cache):
    """The source of axe-core, which finds what hinders people."""
    folder = Path(__file__).parents[1] / "page" / "axe"
    package = installed(folder, Path(cache))
    return (package / "node_modules" / "axe-core" / "axe.min.js").read_text(encoding="utf-8")


async def serious(visitor, script):
    """What axe finds serious or critical in the present view."""
    if not await visitor.page.evaluate("'axe' in window"):
        await visitor.page.evaluate(script)
    found = await visitor.page.evaluate(_VIOLATIONS)
    return [tuple(one) for impact, *one in found if impact in {"serious", "critical"}]
