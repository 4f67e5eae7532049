"""Commands around the live service: ``serve``, ``record``, ``check-config``, ``warm-up``."""

import asyncio
import os
from pathlib import Path
from typing import Annotated

import typer

from valvemap.cli.logs import set_up_logs
from valvemap.cli.options import ConfigOption, ForceOption, SourceOption, new_recording, of_source
from valvemap.cli.output import write_line
from valvemap.cli.progress import working
from valvemap.cli.without import without
from valvemap.config.connections import NamedSourceConfig
from valvemap.config.loading import load_config
from valvemap.config.valve_parts import EdgeConfig, LineConfig
from valvemap.errors import RecordingError


def serve(config: ConfigOption = None) -> None:
    """Subscribe to the source, identify, publish, until Ctrl-C; SIGHUP reads the configuration."""
    with without("cffi"):  # numba supports cffi functions, which no kernel calls
        from numba.core.typing import cffi_utils as _  # noqa: F401

    from valvemap.app.reload import Reload
    from valvemap.app.serve import serve as run
    from valvemap.app.service_manager import ServiceManager
    from valvemap.app.signals import stop_on_signal

    loaded = load_config(config)
    set_up_logs(loaded.log)

    async def until_stopped() -> None:
        stop, reload = asyncio.Event(), Reload(lambda: load_config(config))
        with stop_on_signal(stop, reload.ask_by_signal):
            await run(loaded, stop, reload=reload, manager=ServiceManager.of(os.environ))

    asyncio.run(until_stopped())


def record(
    file: Annotated[
        Path, typer.Argument(help="FILE.csv, .csv.gz, .csv.xz or .parquet", callback=new_recording)
    ],
    config: ConfigOption = None,
    duration: Annotated[
        float | None, typer.Option(min=0.0, metavar="S", help="Stop after S seconds.")
    ] = None,
    source: SourceOption = None,
    *,
    force: ForceOption = False,
) -> None:
    """Record the source's samples to a file."""
    from valvemap.app.record import record as run
    from valvemap.app.signals import stop_on_signal

    loaded = of_source(load_config(config), source)
    set_up_logs(loaded.log)

    async def until_stopped() -> int:
        stop = asyncio.Event()
        of = "" if duration is None else f", {duration:g} s"
        with stop_on_signal(stop), working(f"waiting for the source{of}") as say:
            recorded = lambda n: say(f"{file.name}: {n:,} samples{of}")  # noqa: E731
            return await run(loaded, file, stop, duration, recorded)

    n = asyncio.run(until_stopped())
    if n == 0:
        raise RecordingError(
            f"{file}: no sample was made; `valvemap check-config --online` shows the timing of "
            "the signals"
        )
    write_line(f"{file}: {n:,} samples")


def check_config(
    config: Annotated[Path, typer.Argument(metavar="FILE", help="Configuration (TOML).")],
    *,
    online: Annotated[
        bool, typer.Option("--online", help="Also connect to the source and watch its signals.")
    ] = False,
    watch: Annotated[
        float,
        typer.Option(
            min=1.0, max=3600.0, metavar="S", help="With --online: duration of the watch."
        ),
    ] = 10.0,
    source: SourceOption = None,
) -> None:
    """Check a configuration file and print its effect."""
    whole = load_config(config)
    loaded = whole if source is None else of_source(whole, source)
    names = [named.name for named in loaded.sources]
    if online:
        from valvemap.app.watching import check_online

        for watched in [of_source(loaded, name) for name in names] or [loaded]:
            with working(f"watching {watched.source.url} for {watch:g} s"):
                lines = asyncio.run(check_online(watched, watch))
            for line in lines:
                write_line(line)
    for of_valves in loaded.all_sources:
        named = f"{of_valves.name}: " if isinstance(of_valves, NamedSourceConfig) else ""
        write_line(f"source   {named}{of_valves.url} ({of_valves.security})")
    write_line(f"results  {loaded.server.url}")
    if loaded.history.file is not None:
        from valvemap.app.history_span import span_in_words

        write_line(f"history  {loaded.history.file}: {span_in_words(loaded)}")
    for valve in loaded.valves:
        if isinstance(valve, LineConfig):
            for edge in valve.not_learnt:
                write_line(f"valve    {valve.valve}: {edge}")
            write_line(
                f"line     {valve.name}: leakage where U is within ± {valve.closed_percent:g} %"
            )
            continue
        estimators = ", ".join(estimator.name for estimator in valve.estimators)
        at = "" if valve.source is None else f" at {valve.source}"
        kind = "edge " if isinstance(valve, EdgeConfig) else "valve"
        write_line(f"{kind}    {valve.name}{at}: {estimators}")
    for axis in loaded.axes:
        at = "" if axis.source is None else f" at {axis.source}"
        write_line(f"axis     {axis.name}{at}: four edges, bulk modulus and leakage")
    write_line(f"{config}: good")


def warm_up(config: ConfigOption = None) -> None:
    """Compile the estimators ahead (for images)."""
    from valvemap.app.warm_up import warm_up as run
    from valvemap.cli.rig_kernels import compile_rig_kernels

    with working("compiling: a minute at first") as say:
        run(load_config(config), lambda done, of: say(f"compiling: {done} of {of} parts are done"))
        compile_rig_kernels()
