"""The page in a separate process: ``python page_process.py [CERTIFICATE KEY]``, until SIGTERM.

Prints its URL. The service behind it takes a password check's time, and "right" from everybody.
"""

import asyncio
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[2]))

from support.shown_service import ShownService
from valvemap.app.dashboard import serve_page
from valvemap.app.signals import stop_on_signal
from valvemap.clock import SystemClock
from valvemap.errors import SourceRejected
from valvemap.page.settings import PageSettings
from valvemap.page.web import Page

CHECK_S = 0.15  # of one password: connecting, hashing


class User(ShownService):
    """A connection as a user."""

    password = ""

    async def connect(self):
        await asyncio.to_thread(time.sleep, CHECK_S)
        if self.password != "right":
            raise SourceRejected("user or password are wrong")


def clients(_user, password, _address):
    user = User()
    user.password = password
    return user, None


def say(url):
    sys.stdout.write(f"{url}\n")
    sys.stdout.flush()


async def main(*files):
    certificate, key = map(Path, files) if files else (None, None)
    settings = PageSettings(port=0, certificate=certificate, key=key)
    stop = asyncio.Event()
    page = Page(ShownService(), clients, settings, SystemClock())
    with stop_on_signal(stop):
        await serve_page(page, stop, say)


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
