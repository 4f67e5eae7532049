"""Questions asked of the page by keyboard alone: each key, each typed text counts as an action."""

MOST_ACTIONS = 3


class Keyboard:
    """Counts what a person does until the answer is there."""

    def __init__(self, page):
        self.page, self.actions = page, 0

    async def press(self, key):
        """A key that leads somewhere at once."""
        self._count()
        await self.page.keyboard.press(key)

    async def type(self, text):
        """Text into the field that has the focus, and Tab to the next one."""
        self._count()
        await self.page.keyboard.type(text)
        await self.page.keyboard.press("Tab")

    async def open(self, locator):
        """A link or button: reached by Tab, opened by Enter."""
        self._count()
        await locator.wait_for()
        for _ in range(200):
            if await locator.evaluate("one => one === document.activeElement"):
                break
            await self.page.keyboard.press("Tab")
        await self.page.keyboard.press("Enter")

    def _count(self):
        self.actions += 1
        assert self.actions <= MOST_ACTIONS, "too many actions"
