"""What tests of the page share."""

import pytest_asyncio

from support.browser import chromium


@pytest_asyncio.fixture(scope="session", loop_scope="session")
async def browser():
    """One browser for all tests; each has a context of its own, closed at its end."""
    async with chromium() as found:
        yield found
