"""``valvemap fleet``: the pipeline distributed over machines with Kafka."""

import asyncio
import os
import time
from collections.abc import Awaitable, Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valvemap.cli.logs import set_up_logs
from valvemap.cli.options import (
    ConfigOption,
    ForceOption,
    InsistOption,
    MetricsHostOption,
    MetricsOption,
    metrics_address,
    new_models,
)
from valvemap.cli.output import write_line
from valvemap.cli.progress import bars
from valvemap.errors import ConfigurationError, FleetError

if TYPE_CHECKING:
    from valvemap.kafka.settings import FleetConfig

FleetOption = Annotated[
    Path,
    typer.Option(
        "--config",
        "-c",
        metavar="FILE",
        help="The fleet's configuration (TOML); VALVEMAP_FLEET_<SECTION>__<FIELD> overrides it.",
    ),
]
SiteArgument = Annotated[
    str | None, typer.Argument(help="Site of the catalogue; optional if there is one.")
]
CONFIG = Path("config/fleet.toml")
_NOTES = "done"  # folder of completion records, see `valvemap.kafka.reidentify`

fleet = typer.Typer(
    help="Identify the valves of many machines, through Kafka.", no_args_is_help=True
)


@fleet.callback()
def _needs_the_extra() -> None:
    for needed in ("confluent_kafka", "distributed", "pyarrow", "quixstreams"):
        if find_spec(needed) is None:
            raise ConfigurationError(f"a fleet needs {needed}: pip install 'valvemap[fleet]'")


@fleet.command()
def topics(config: FleetOption = CONFIG) -> None:
    """Create missing topics and check existing ones."""
    from valvemap.kafka.settings import load_fleet
    from valvemap.kafka.topics import create_or_check

    for line in create_or_check(load_fleet(config)):
        write_line(line)


@fleet.command()
def collect(
    site: SiteArgument = None,
    config: FleetOption = CONFIG,
    metrics: MetricsOption = None,
    metrics_host_name: MetricsHostOption = None,
) -> None:
    """Send the samples of a site's sources to the workers, until Ctrl-C."""
    from valvemap.kafka.collect import collect as run

    address = metrics_address(metrics, metrics_host_name)
    _run_until_stopped(partial(run, address=address), site, config)


@fleet.command()
def work(
    config: FleetOption = CONFIG,
    metrics: MetricsOption = None,
    metrics_host_name: MetricsHostOption = None,
) -> None:
    """Learn from the topics' samples, beside other workers, until Ctrl-C."""
    from valvemap.kafka.settings import load_fleet
    from valvemap.kafka.work import work as run

    loaded, address = load_fleet(config), metrics_address(metrics, metrics_host_name)
    set_up_logs()
    run(loaded, address)


@fleet.command()
def serve(
    site: SiteArgument = None,
    config: FleetOption = CONFIG,
) -> None:
    """Serve a site's results to OPC UA clients, until Ctrl-C."""
    from valvemap.kafka.serve import serve as run

    _run_until_stopped(run, site, config)


def _own_models(context: typer.Context, option: typer.CallbackParam, value: Path) -> Path | None:
    """Check the folder of the models; an unfinished run may be continued."""
    return value if (value / _NOTES).is_dir() else new_models(context, option, value)


@fleet.command()
def reidentify(
    files: Annotated[
        list[Path], typer.Argument(help="Recordings, in the order of their time.", metavar="FILES")
    ],
    out: Annotated[
        Path,
        typer.Option("--out", metavar="DIR", help="Folder of the models.", callback=_own_models),
    ],
    config: ConfigOption = None,
    processes: Annotated[
        int, typer.Option(min=1, max=1_024, metavar="N", help="Number of processes.")
    ] = os.cpu_count() or 1,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="A Dask cluster instead, e.g. tcp://north:8786."),
    ] = None,
    *,
    force: ForceOption = False,
    insist: InsistOption = False,
) -> None:
    """Identify valves from recordings again, on all processors; resumes after a kill."""
    from valvemap.config.loading import load_config
    from valvemap.kafka.reidentify import reidentify as run

    loaded = None if config is None else load_config(config)
    with bars() as shown:
        bar = shown.add_task("valves", total=None)
        found = run(
            files,
            out,
            loaded,
            processes=processes,
            scheduler=scheduler,
            insist=insist,
            progress=lambda done, of: shown.update(bar, completed=done, total=of),
        )
    known = f", {found.known} of them before" if found.known else ""
    write_line(f"{out}: {found.valves} valves{known}")
    if found.refused:
        raise FleetError("; ".join(found.refused))


@fleet.command()
def status(config: FleetOption = CONFIG) -> None:
    """Show each group's worker, lag and processed blocks."""
    from valvemap.kafka.settings import load_fleet
    from valvemap.kafka.status import lines
    from valvemap.kafka.status import status as look

    for line in lines(look(load_fleet(config)), time.time_ns()):
        write_line(line)


def _run_until_stopped(
    run: "Callable[[FleetConfig, str | None, asyncio.Event], Awaitable[None]]",
    site: str | None,
    config: Path,
) -> None:
    from valvemap.app.signals import stop_on_signal
    from valvemap.kafka.settings import load_fleet

    loaded = load_fleet(config)
    set_up_logs()

    async def until_stopped() -> None:
        stop = asyncio.Event()
        with stop_on_signal(stop):
            await run(loaded, site, stop)

    asyncio.run(until_stopped())
