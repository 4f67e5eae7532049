"""Requests and checks for reloading the configuration of a running service."""

import asyncio
from collections.abc import Callable

import structlog

from guarded_opcua import HardenedError
from valvemap.config.models import Config
from valvemap.errors import CommandRejected, ConfigurationError, ValvemapError

log = structlog.get_logger(__name__)

Outcome = asyncio.Future[None]


class Reload:
    """A queue of requests to reload the configuration; each request gets its outcome.

    Parameters
    ----------
    load
        Reads the configuration; raises ConfigurationError.
    """

    def __init__(self, load: Callable[[], Config]) -> None:
        self.load = load
        self.requests: asyncio.Queue[Outcome] = asyncio.Queue()

    def ask(self) -> Outcome:
        """Request a reload without waiting; the future completes or has the error."""
        outcome: Outcome = asyncio.get_running_loop().create_future()
        self.requests.put_nowait(outcome)
        return outcome

    def ask_by_signal(self) -> None:
        """Request a reload on SIGHUP and ignore the outcome."""
        log.info("hang-up: the configuration is read again")
        self.ask().add_done_callback(lambda outcome: outcome.cancelled() or outcome.exception())

    async def call(self) -> None:
        """Request a reload and wait for its outcome.

        Raises
        ------
        CommandRejected
            if the new configuration is rejected; gives the reason.
        """
        try:
            await self.ask()
        except (ValvemapError, HardenedError) as error:
            raise CommandRejected(in_one_line(error)) from error


def check_what_stays(before: Config, config: Config) -> None:
    """Check that fields which a running service cannot change are unchanged.

    Raises
    ------
    ConfigurationError
        if one has changed; names the field.
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
    """Return the lines of an error message joined to one."""
    return "; ".join(str(error).splitlines())
