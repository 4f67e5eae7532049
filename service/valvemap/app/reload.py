"""Another configuration for a service that runs: asked for, checked, put in force."""

import asyncio
from collections.abc import Callable

import structlog

from guarded_opcua import HardenedError
from valvemap.config.models import Config
from valvemap.errors import CommandRejected, ConfigurationError, ValvemapError

log = structlog.get_logger(__name__)

Outcome = asyncio.Future[None]


class Reload:
    """Where somebody asks for the configuration to be read again, and hears what became of it.

    Parameters
    ----------
    load
        Reads the configuration; raises ConfigurationError.
    """

    def __init__(self, load: Callable[[], Config]) -> None:
        self.load = load
        self._asked: asyncio.Queue[Outcome] = asyncio.Queue()

    def ask(self) -> Outcome:
        """Ask, without waiting; the future says when it is in force, or raises why it is not."""
        outcome: Outcome = asyncio.get_running_loop().create_future()
        self._asked.put_nowait(outcome)
        return outcome

    def ask_by_signal(self) -> None:
        """Ask for somebody who waits for no answer."""
        log.info("hang-up: the configuration is read again")
        self.ask().add_done_callback(lambda outcome: outcome.cancelled() or outcome.exception())

    async def call(self) -> None:
        """Ask, and wait.

        Raises
        ------
        CommandRejected
            saying why the old configuration goes on.
        """
        try:
            await self.ask()
        except (ValvemapError, HardenedError) as error:
            raise CommandRejected(in_one_line(error)) from error

    async def asked(self) -> Outcome:
        """Wait until somebody asks."""
        return await self._asked.get()


def check_what_stays(before: Config, config: Config) -> None:
    """Compare what a running service cannot change.

    Raises
    ------
    ConfigurationError
        naming the field.
    """
    changed = [("state.file", before.state.file, config.state.file)]
    changed += [
        (f"history.{field}", getattr(before.history, field), getattr(config.history, field))
        for field in type(config.history).model_fields
    ]
    for name, old, new in changed:
        if new != old:
            raise ConfigurationError(
                f"{name} = '{new}': cannot change while the service runs; restart it"
            )


def in_one_line(error: Exception) -> str:
    """An error's lines as one."""
    return "; ".join(str(error).splitlines())
