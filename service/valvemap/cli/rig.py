"""``valvemap rig``: the virtual test rig."""

import asyncio
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from guarded_opcua import Limits, Pki, Role, ServerSettings, UserStore
from valvemap.app.identities import PAGE_URI, PRODUCT, RIG_NAME, RIG_URI, load_users
from valvemap.app.signals import stop_on_signal, stop_with_parent
from valvemap.cli.logs import set_up_logs
from valvemap.cli.options import FolderOption, ForceOption, RevocationOption, new_file
from valvemap.cli.output import write_line
from valvemap.cli.progress import bars
from valvemap.cli.rig_conditions import CONDITION_S, condition_line, start_line
from valvemap.cli.rig_kernels import keep_rig_kernels
from valvemap.config.logs import LogConfig
from valvemap_rig.blocks import RigBlock
from valvemap_rig.fleet_server import FleetServer
from valvemap_rig.scenario import Fleet, Scenario, load_scenario
from valvemap_rig.server import RigServer
from valvemap_rig.simulation import advance, initial

if TYPE_CHECKING:
    from valvemap.model.samples import Samples

URL = "opc.tcp://127.0.0.1:4840/valvemap/rig/"

_BLOCK = 1_000
_SENSORS: tuple[Literal["U", "p1", "p2", "Q", "T"], ...] = ("U", "p1", "p2", "Q", "T")


def rig(
    scenario: Annotated[
        str, typer.Option(metavar="NAME", help="Built-in scenario, or a TOML file.")
    ] = "structured",
    url: Annotated[
        str, typer.Option(envvar="VALVEMAP_RIG_URL", help="opc.tcp://ADDRESS:PORT/PATH")
    ] = URL,
    data: FolderOption = Path("data"),
    host: Annotated[
        list[str] | None,
        typer.Option(envvar="VALVEMAP_RIG_HOSTS", help="Name under which clients reach the rig."),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Also record every sample to FILE.", callback=new_file),
    ] = None,
    duration: Annotated[
        float | None, typer.Option(min=0.0, metavar="S", help="Stop after S seconds of rig time.")
    ] = None,
    valves: Annotated[
        int | None,
        typer.Option(
            min=1, max=20_000, metavar="N", help="Play a fleet of N valves from a recording."
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(min=1.0, max=1_000.0, metavar="HZ", help="Samples of each valve per second."),
    ] = None,
    publishing_interval: Annotated[
        float,
        typer.Option(
            min=1.0, max=60_000.0, metavar="MS", help="Shortest publishing interval for clients."
        ),
    ] = Limits.publishing_interval_ms,
    *,
    force: ForceOption = False,
    require_crl: RevocationOption = True,
    offline: Annotated[
        bool, typer.Option("--offline", help="Record as fast as possible, without a server.")
    ] = False,
    under_demo: Annotated[bool, typer.Option("--under-demo", hidden=True)] = False,
) -> None:
    """Run the virtual test rig, an OPC UA server, until Ctrl-C."""
    keep_rig_kernels()
    loaded = load_scenario(scenario)
    if duration is not None:
        loaded = loaded.model_copy(update={"duration_s": duration})
    if rate is not None:
        loaded = loaded.model_copy(update={"sample_rate_hz": rate})
    if valves is not None:
        loaded = loaded.model_copy(update={"fleet": Fleet(valves=valves)})
    if loaded.fleet is not None and (offline or record is not None):
        raise typer.BadParameter("a fleet plays a recording, it makes none")
    if offline:
        record_offline(loaded, record)
        return
    set_up_logs(LogConfig(level="error" if under_demo else "info"))
    limits = Limits(publishing_interval_ms=publishing_interval)
    asyncio.run(
        _serve(
            loaded,
            url,
            data,
            host or [],
            record,
            limits,
            require_crl=require_crl,
            under_demo=under_demo,
        )
    )


def record_offline(scenario: Scenario, file: Path | None) -> None:
    """Write a recording without a server; the scenario must end."""
    from valvemap.clock import SystemClock

    if file is None or scenario.samples is None:
        raise typer.BadParameter("--offline needs --record FILE and --duration S")
    state = initial(scenario, SystemClock().now())
    with ExitStack() as stack:
        append = _recording(scenario, file, stack)
        progress = stack.enter_context(bars())
        task = progress.add_task(file.name, total=scenario.samples)
        while state.index < scenario.samples:
            state, block = advance(scenario, state, _BLOCK)
            append(block)
            progress.update(task, completed=state.index)
    write_line(f"{file}: {state.index:,} samples of each valve")


def _recording(scenario: Scenario, file: Path, stack: ExitStack) -> Callable[[RigBlock], None]:
    """Open a recording until the stack closes; return what appends a block to it."""
    if scenario.machines:
        if scenario.valves:
            raise typer.BadParameter(
                "a scenario with valves and machines is not recorded in one file; take one of them "
                "out of it"
            )
        from valvemap.cli.machine_recording import MachineWriter

        return stack.enter_context(MachineWriter(file, scenario.machines)).append
    from valvemap.storage.recording_writer import RecordingWriter

    writer = stack.enter_context(RecordingWriter(file))
    return lambda block: _append(writer.append, block)


def _append(append: "Callable[[str, Samples], None]", block: RigBlock) -> None:
    """Record complete samples only, as a client that aligns them would get."""
    import numpy as np

    from valvemap.model.samples import Samples

    for name, valve in block.valves.items():
        columns = {signal: getattr(valve, signal) for signal in _SENSORS}
        severity = [np.minimum(valve.status[signal] >> 30, 2) for signal in _SENSORS]
        complete = np.all([valve.present[signal] for signal in _SENSORS], axis=0)
        samples = Samples.of(t=valve.t, **columns, quality=np.max(severity, axis=0))
        append(name, samples[complete])


async def _serve(
    scenario: Scenario,
    url: str,
    data: Path,
    hosts: list[str],
    record: Path | None,
    limits: Limits,
    *,
    require_crl: bool,
    under_demo: bool,
) -> None:
    stop = asyncio.Event()
    users = UserStore()
    if under_demo:
        users.add("operator", Role.OPERATOR, sys.stdin.readline().strip())
        stop_with_parent(stop)
    else:
        users = load_users(data / "users.json")
    settings = ServerSettings(
        url=url,
        application_uri=RIG_URI,
        application_name=RIG_NAME,
        namespace_uri=RIG_URI,
        pki=None if under_demo else Pki(data / "pki" / "rig"),
        require_crl=require_crl,
        users=users,
        none_on_loopback=under_demo,
        gateways=frozenset({PAGE_URI}),
        host_names=tuple(hosts),
        limits=limits,
        product=PRODUCT,
    )
    with ExitStack() as stack:
        stack.enter_context(stop_on_signal(stop))
        server: RigServer | FleetServer
        if scenario.fleet is not None:
            server = await FleetServer.create(settings, scenario)
            async with server:
                write_line(server.url)  # the parent process waits for it
                await _play(server, stop, until_over=scenario.samples is not None)
            return
        on_block = None
        if record is not None:
            on_block = _recording(scenario, record, stack)
        server = await RigServer.create(settings, scenario, on_block=on_block)
        async with server:
            write_line(server.url)  # the parent process waits for it
            if under_demo:
                stack.callback(asyncio.ensure_future(_say_conditions(server)).cancel)
            await _play(server, stop, until_over=scenario.samples is not None)


async def _say_conditions(server: RigServer) -> None:
    """Print start and conditions whenever they change, for the demo's true maps."""
    before, start_ns = None, 0
    while True:
        if server.start_ns != start_ns:
            start_ns = server.start_ns
            write_line(start_line(start_ns))
        now = condition_line(server.conditions())
        if now != before:
            write_line(now)
            before = now
        await asyncio.sleep(CONDITION_S)


async def _play(server: RigServer | FleetServer, stop: asyncio.Event, *, until_over: bool) -> None:
    playing = asyncio.ensure_future(server.run())
    stopped = asyncio.ensure_future(stop.wait())
    waited_for: set[asyncio.Future[Any]] = {playing, stopped}
    try:
        while not (playing.done() or stopped.done()):
            await asyncio.wait(waited_for, timeout=0.1, return_when=asyncio.FIRST_COMPLETED)
            if until_over and isinstance(server, RigServer) and server.scenario is None:
                break
        if playing.done():
            playing.result()
    finally:
        playing.cancel()
        stopped.cancel()
        await asyncio.gather(playing, stopped, return_exceptions=True)
