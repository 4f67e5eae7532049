"""What people do to a running service: clients call it, and somebody starts it a second time."""

import asyncio
import math
from typing import Final

import numpy as np

from simulation.draws import COMMANDS
from simulation.source_client import Client
from valvemap.errors import CommandRejected, StorageError
from valvemap.pipeline.operator_ports import Command
from valvemap.runtime.live import LiveService
from valvemap.runtime.sources import Part, Sources, supervise_all
from valvemap.storage.state_lock import FileLock
from valvemap.vocabulary.statuses import InverseStatus, Status

FORGETTING: Final = {"forget more": 0.97, "forget nothing": 1.0}  # lam


async def act(world, live, settings, supervision):
    """Clients call the service, and somebody starts a second one."""
    rivals = [(at, "rival", 0) for at in world.case.rivals]
    reading = [_read_later(world, *read) for read in world.case.reads]
    reads = [asyncio.create_task(one) for one in reading]
    for at, kind, valve in sorted(
        [*world.case.calls, *world.case.commands, *world.case.leads, *rivals], key=_in_time
    ):
        if at < world.time.elapsed:
            continue
        await asyncio.sleep(at - world.time.elapsed)
        if kind == "rival":
            await rival(world, settings, supervision)
        elif (at, kind, valve) in world.case.leads:
            world.leading.operate(live.identification, kind, valve)
        elif kind in COMMANDS:
            operate(world, live.identification, kind, valve)
            world.counts[kind] += 1
        else:
            call(world, live.identification, kind, valve)

    await asyncio.gather(*reads)


def call(world, identification, kind, valve):
    """A client's call; it is answered at once, with a status that fits its values."""
    one = world.plant[valve]
    match kind:
        case "demand":
            identification.do(Command.of("demand", one.name, 40.0, 80.0))
            answer, _ = identification.answers.required(valve)
            _judge_U(world, one, answer.U, answer.status)
        case "invert":
            answer = identification.invert(one.name, 40.0, 80.0, math.nan)
            _judge_U(world, one, *answer.U, *answer.status)
        case "predict":
            Q, std, status = identification.predict(one.name, one.estimator, 50.0, 80.0, math.nan)
            if status in (Status.OK, Status.UNEXCITED) and not np.isfinite([Q, std]).all():
                world.violated(f"{one.name} predicts {Q} ± {std}, {status.name}")
        case "freeze and resume":
            operate(world, identification, "freeze", valve)
            operate(world, identification, "resume", valve)
        case "unknown":
            _judge_rejected(
                world,
                identification,
                Command.of("set_forgetting_factor", one.name, one.estimator, 7.0),
            )
        case "not finite":
            answer = identification.invert(one.name, math.nan, math.inf, math.nan)
            if not np.isnan(answer.U).all():
                world.violated(f"{one.name}: no demand needs {answer.U} %")
    world.counts["calls"] += 1


def operate(world, identification, kind, valve):
    """An operator's command on an estimator: it is kept with the samples learnt before it."""
    world.commands[valve].append((len(world.learnt[valve]), kind))
    command(identification, kind, world.plant[valve])


def command(identification, kind, one):
    """An operator's command on the estimator of an installed valve."""
    if kind in FORGETTING:
        given = Command.of("set_forgetting_factor", one.name, one.estimator, FORGETTING[kind])
    else:
        given = Command.of(kind, one.name, one.estimator)
    identification.do(given)


def _judge_U(world, one, U, status):
    found = InverseStatus(int(status))
    if found is InverseStatus.OK and not 0.0 <= U <= 100.0:
        world.violated(f"{one.name} needs {U} %, {found.name}")
    if found is InverseStatus.UNIDENTIFIED and not np.isnan(U):
        world.violated(f"{one.name} needs {U} %, though nothing is known")


def _judge_rejected(world, identification, command):
    try:
        identification.do(command)
    except CommandRejected:
        return
    world.violated(f"{command} was accepted")


class Unseen:
    """A sink for results that nobody reads."""

    async def publish(self, results):
        pass

    async def doubt(self, valves):
        pass

    async def show_health(self, health):
        pass


async def rival(world, settings, supervision):
    """A second service on the same state file: it is refused, or else it does what services do."""
    try:
        lock = FileLock(world.lock_path)
    except StorageError:
        world.counts["rivals refused"] += 1
        return
    try:
        clients = [Client(server, world.time, world.plant) for server in world.servers]
        world.clients += clients
        parts = [
            Part(str(n) if len(clients) > 1 else None, client, client.server.case.valves)
            for n, client in enumerate(clients)
        ]
        sources, identification = Sources(parts), world.fresh()
        live = LiveService(identification, sources, Unseen(), world.states, world.time, settings)
        await live.start()
        await supervise_all(sources, live, world.time, asyncio.Event(), supervision)
    finally:
        lock.close()


async def _read_later(world, at, *read):
    if at >= world.time.elapsed:
        await asyncio.sleep(at - world.time.elapsed)
        await world.rows.read(*read)


def _in_time(event):
    at, kind, valve = event
    return at, str(kind), valve
