"""``valvemap commission``: drives a valve through its range."""

import asyncio
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valvemap.cli.logs import set_up_logs
from valvemap.cli.options import ConfigOption, FolderOption
from valvemap.cli.output import write_line
from valvemap.cli.progress import working
from valvemap.clock import SystemClock
from valvemap.config.loading import config_of, load_config
from valvemap.errors import ConfigurationError

if TYPE_CHECKING:
    from valvemap.config.models import Config


def commission(
    valve: Annotated[str, typer.Argument(metavar="VALVE", help="Name of the valve.")],
    config: ConfigOption = None,
    accuracy: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=1e6,  # no infinite one
            metavar="Q",
            help="End when the map's 95 % interval is ± Q l/min or less; 0: use the whole time.",
        ),
    ] = 0.0,
    data: FolderOption = Path("data"),
    *,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the plan; connect to nothing.")
    ] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue the valve's last, interrupted run.")
    ] = False,
    unattended: Annotated[
        bool,
        typer.Option(
            "--unattended", help="Run without a terminal: only the source's watchdog stands guard."
        ),
    ] = False,
) -> None:
    """Drive a valve through its range until its map is known, within limits."""
    from valvemap.app.commission_settings import plan_in_words, settings_of

    loaded = config_of(load_config(config), valve)
    settings = settings_of(loaded.valves[0], accuracy / 1.96)
    if dry_run:
        for line in plan_in_words(loaded.valves[0], settings):
            write_line(line)
        return
    if not (unattended or sys.stdin.isatty()):
        raise ConfigurationError(
            "commission needs a terminal, whose end stops the run; in a script, add --unattended"
        )
    set_up_logs(loaded.log)
    over = asyncio.run(_run(loaded, accuracy, data, resume=resume, unattended=unattended))
    if not over:
        raise typer.Exit(1)


async def _run(
    config: "Config", accuracy: float, data: Path, *, resume: bool, unattended: bool
) -> bool:
    """Run until the end; return whether it was reached."""
    from valvemap.app.commission import CommissionRun, is_armed, result_in_words
    from valvemap.app.commission_settings import settings_of
    from valvemap.storage.commission_files import RunFiles, last_run, new_run
    from valvemap.vocabulary.commission import Phase

    (valve,) = config.valves
    folder = data / "commission"
    recording = new_run(folder, valve.name, SystemClock().now())
    if resume:
        found = last_run(folder, valve.name)
        if found is None:
            raise ConfigurationError(f"--resume: {folder} holds no run of valve {valve.name}")
        if RunFiles(found, valve.name).elapsed() >= valve.commission.most_s:
            raise ConfigurationError(
                f"--resume: the last run of {valve.name} was complete; without --resume a new one "
                "begins"
            )
        recording = found
    armed = await is_armed(config, data)
    with RunFiles(recording, valve.name) as files, working("connecting") as say:
        run = CommissionRun(
            config,
            settings_of(valve, accuracy / 1.96),
            files,
            operator=(lambda: (0.0, 0.0)) if unattended else _terminal(),
            progress=say,
            armed=armed,
        )
        with _aborting(run.abort, reads_terminal=not unattended):
            state = await run.run()
    for line in result_in_words(run, files, valve.name):
        write_line(line)
    return state.phase is Phase.DONE


def _terminal() -> Callable[[], tuple[float, float]]:
    """Return how long ago the terminal was last there, and this process in its foreground, s.

    It is asked at every step, so its next sign is always due: the delay is the age.
    """
    clock = SystemClock()
    last = clock.monotonic()

    def age() -> tuple[float, float]:
        nonlocal last
        with suppress(OSError):
            if os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp():
                last = clock.monotonic()
        gone_s = clock.monotonic() - last
        return gone_s, gone_s

    return age


@contextmanager
def _aborting(abort: Callable[[], None], *, reads_terminal: bool) -> Iterator[None]:
    """Abort on Ctrl-C, a termination signal or a hang-up; with a terminal, on Enter or its end."""
    loop = asyncio.get_running_loop()
    numbers = [signal.SIGINT, signal.SIGTERM]
    with suppress(AttributeError):  # Windows has none
        numbers.append(signal.SIGHUP)
    before = {
        number: signal.signal(number, lambda *_: loop.call_soon_threadsafe(abort))
        for number in numbers
    }
    stdin = sys.stdin.fileno() if reads_terminal else None

    def on_input() -> None:
        os.read(sys.stdin.fileno(), 1024)
        loop.remove_reader(sys.stdin.fileno())
        abort()

    if stdin is not None:
        loop.add_reader(stdin, on_input)
    try:
        yield
    finally:
        if stdin is not None:
            loop.remove_reader(stdin)
        for number, handler in before.items():
            signal.signal(number, handler)
