"""What every demo runs: the service with its page, shown in the terminal until the end."""

import asyncio
from collections.abc import Coroutine
from dataclasses import dataclass, field
from typing import Any, Protocol, Self

from pydantic import SecretStr
from rich.console import Console
from rich.live import Live
from rich.table import Table

from guarded_opcua import Role, ServerSettings, UserStore
from valvemap.app.identities import APPLICATION_NAME, APPLICATION_URI, PAGE_URI, PRODUCT
from valvemap.app.warm_up import warm_up
from valvemap.cli.under_demo import page_process
from valvemap.config.models import Config

_REFRESH_S = 1.0
_LINE_S = 5.0


class Watched(Protocol):
    """A view that the demo shows while it runs."""

    def table(self) -> Table:
        """Table for a terminal."""

    def lines(self) -> list[str]:
        """Lines for a log."""


@dataclass(frozen=True)
class Stage:
    """A demo's configuration, its operator's account, its console, and the event that ends it."""

    config: Config
    console: Console
    users: UserStore
    password: str
    stop: asyncio.Event = field(default_factory=asyncio.Event)

    @classmethod
    def of(cls, config: Config, console: Console, *, writes: bool) -> Self:
        """Give the operator a password; ``writes``: the service is the operator at the rig."""
        users, password = UserStore.one_time("operator", Role.OPERATOR)
        if writes:
            writer = {"user": "operator", "password": SecretStr(password)}
            source = config.source.model_copy(update=writer)
            config = config.model_copy(update={"source": source})
        return cls(config, console, users, password)

    async def compile(self) -> bool:
        """Compile what the service needs; return whether the demo goes ahead."""

        def say(done: int, of: int) -> None:
            self.console.print(f"compiled {done} of {of} parts")

        await asyncio.to_thread(warm_up, self.config, say, self.stop.is_set)
        return not self.stop.is_set()

    async def show(
        self,
        serving: Coroutine[Any, Any, None],
        view: Watched,
        rig_url: str,
        duration: float | None,
        *more: str,
    ) -> None:
        """Run the service and its page, and show a view until the end."""
        running = asyncio.ensure_future(serving)
        async with page_process(self.config.server.url, rig_url) as page:
            _say_where(self.console, self.config, rig_url, self.password, page, *more)
            await _show(view, self.console, self.stop, running, duration)

    @property
    def settings(self) -> ServerSettings:
        """Settings of the service's server."""
        return ServerSettings(
            url=self.config.server.url,
            application_uri=APPLICATION_URI,
            application_name=APPLICATION_NAME,
            namespace_uri=APPLICATION_URI,
            users=self.users,
            none_on_loopback=True,
            gateways=frozenset({PAGE_URI}),
            product=PRODUCT,
        )


def _say_where(
    console: Console, config: Config, rig_url: str, password: str, page: str, *more: str
) -> None:
    console.print(f"page      {page}", soft_wrap=True)
    console.print(f"rig       {rig_url}")
    console.print(f"service   {config.server.url}")
    console.print("security  None, on this machine only; anonymous may look")
    console.print(f"operator  user operator, password {password}")
    for line in more:
        console.print(line, soft_wrap=True)
    console.print("Ctrl-C ends it.\n")


async def _show(
    view: Watched,
    console: Console,
    stop: asyncio.Event,
    serving: "asyncio.Future[None]",
    duration: float | None,
) -> None:
    """Refresh the table, or print lines if the console is no terminal, until the end; then stop."""
    try:
        await _watch(view, console, stop, serving, duration)
    finally:
        stop.set()
        await serving


async def _watch(
    view: Watched,
    console: Console,
    stop: asyncio.Event,
    serving: "asyncio.Future[None]",
    duration: float | None,
) -> None:
    loop = asyncio.get_running_loop()
    end = None if duration is None else loop.time() + duration
    pause = _REFRESH_S if console.is_terminal else _LINE_S
    with Live(console=console, auto_refresh=False, transient=True) as live:
        while not stop.is_set() and not serving.done():
            left = pause if end is None else min(pause, end - loop.time())
            if left <= 0:
                return
            stopped = asyncio.ensure_future(stop.wait())
            ends: set[asyncio.Future[Any]] = {stopped, serving}
            await asyncio.wait(ends, timeout=left, return_when=asyncio.FIRST_COMPLETED)
            stopped.cancel()
            if console.is_terminal:
                live.update(view.table(), refresh=True)
            else:
                for line in view.lines():
                    console.print(line, soft_wrap=True)
