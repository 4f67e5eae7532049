"""Another configuration while the service runs: who is left alone misses nothing."""

import asyncio
import signal
import sys
from contextlib import asynccontextmanager, suppress
from types import SimpleNamespace

import numpy as np
import pytest
import structlog
from asyncua import ua

from guarded_opcua import Role, ServerSettings, UserStore
from support.processes import free_port, rig_url, running, service_url, wait_for
from support.served import patient
from support.stream import until
from valvemap.app.build import build_identification
from valvemap.app.reload import Reload
from valvemap.app.serve import serve
from valvemap.app.shown import is_same_server
from valvemap.config.estimators import RlsConfig
from valvemap.config.valves import NodesConfig, ValveConfig
from valvemap.errors import ConfigurationError, StorageError
from valvemap.model.samples import Samples
from valvemap.runtime.live import LiveService
from valvemap.storage.checkpoints import CheckpointFile
from valvemap_rig.scenario import BUILTIN, ValveBench
from valvemap_rig.server import RigServer

pytestmark = pytest.mark.waits

RATE_HZ = 100
STEP_NS = 10_000_000
SLOW, QUICK = RlsConfig(name="RLS", lam=1.0), RlsConfig(name="RLS", lam=0.99)


@asynccontextmanager
async def rig_of(url, *names):
    settings = ServerSettings(
        url=url,
        application_uri="urn:valvemap:rig",
        application_name="valvemap rig",
        namespace_uri="urn:valvemap:rig",
        none_on_loopback=True,
    )
    valves = tuple(ValveBench(name=name) for name in names)
    scenario = BUILTIN["scattered"].model_copy(update={"valves": valves})
    rig = await RigServer.create(settings, scenario)
    async with rig:
        playing = asyncio.create_task(rig.run())
        try:
            yield rig
        finally:
            playing.cancel()
            with suppress(asyncio.CancelledError):
                await playing
    await asyncio.sleep(0.05)  # until the last connection is closed


async def once_good(node):
    """A value, once it is more than what was kept of it."""
    async with asyncio.timeout(30.0):
        while True:
            found = await node.read_data_value(raise_on_bad_status=False)
            if found.StatusCode.is_good():
                return found.Value.Value
            await asyncio.sleep(0.05)


class Served:
    """A service whose configuration can be changed, and the samples that it learnt from."""

    def __init__(self, config, open_server):
        self.users = UserStore()
        for role in (Role.OPERATOR, Role.ENGINEER):
            self.users.add(role.name.lower(), role, "correct horse")
        self.config = config
        self.wrong = None
        self.samples = {}
        self.stop = asyncio.Event()
        self.reload = Reload(self._load)
        settings = ServerSettings(**{**vars(open_server), "users": self.users})
        self.task = asyncio.create_task(
            serve(config, self.stop, settings, None, self._tap, self.reload)
        )

    def _load(self):
        if self.wrong is not None:
            raise self.wrong
        return self.config

    def _tap(self, valve, samples):
        self.samples.setdefault(valve, []).append(samples)

    def count(self, valve):
        return sum(map(len, self.samples.get(valve, ())))

    async def until_more(self, valve, n=RATE_HZ):
        target = self.count(valve) + n
        async with asyncio.timeout(90):
            while self.count(valve) < target:
                assert not self.task.done(), self.task.exception()
                await asyncio.sleep(0.05)

    async def call(self, who):
        """StatusCode of the method Reload, called by somebody."""
        client = patient(self.config.server.url)
        client.set_user(who)
        client.set_password("correct horse")
        async with client:
            index = await client.get_namespace_index("urn:valvemap:service")
            folder = client.get_node(ua.NodeId("Service", index))
            try:
                await folder.call_method(ua.NodeId("Service.Reload", index))
            except ua.UaStatusCodeError as error:
                return error.code
        return 0

    async def end(self):
        self.stop.set()
        await self.task


@pytest.fixture
async def served(config, open_server):
    config = config.model_copy(
        update={
            "valves": (
                ValveConfig(name="Boom", estimators=(SLOW,)),
                ValveConfig(name="Bucket", estimators=(SLOW,)),
                ValveConfig(name="Stick", estimators=(SLOW,)),
            )
        }
    )
    async with rig_of(config.source.url, "Boom", "Bucket", "Stick", "Swing"):
        made = Served(config, open_server)
        try:
            await made.until_more("Boom")
            yield made
        finally:
            await made.end()


async def test_valves_left_alone_miss_nothing_and_keep_every_bit(served):
    before = served.config
    for valves in (
        (
            ValveConfig(name="Swing", estimators=(SLOW,)),
            ValveConfig(name="Bucket", estimators=(QUICK,)),
            ValveConfig(name="Boom", estimators=(SLOW,)),
        ),
        (
            ValveConfig(name="Boom", estimators=(SLOW,)),
            ValveConfig(name="Stick", estimators=(SLOW,)),
            ValveConfig(name="Swing", estimators=(SLOW,)),
        ),
    ):
        served.config = before.model_copy(update={"valves": valves})
        await served.reload.call()
        for valve in valves:
            await served.until_more(valve.name)
    await served.end()
    for valve in ("Boom", "Swing"):
        t = np.concatenate([samples.t for samples in served.samples[valve]])
        assert set(np.diff(t)) == {STEP_NS}
    once = build_identification(before)
    once.take_samples(0, Samples.concatenate(served.samples["Boom"]))
    with CheckpointFile(before.state.file) as store:
        kept = {(c.valve, c.estimator): c for c in store.load()}
    (alone,) = [c for c in once.states.checkpoints([0]) if c.estimator == "RLS"]
    assert kept["Boom", "RLS"].state == alone.state


async def test_a_faulty_configuration_is_refused_and_the_old_one_goes_on(served, capsys):
    structlog.reset_defaults()  # another test may have had errors logged alone
    assert await served.call("operator") == ua.StatusCodes.BadUserAccessDenied
    served.wrong = ConfigurationError("plant.toml: valves[0].name = 7: a text is needed")
    assert await served.call("engineer") == ua.StatusCodes.BadInvalidState
    served.wrong = None
    good, nowhere = served.config, NodesConfig.of_rig("Nowhere")
    lost = ValveConfig(name="Lost", nodes=nowhere, estimators=(SLOW,))
    served.config = good.model_copy(update={"valves": (*good.valves, lost)})
    assert await served.call("engineer") == ua.StatusCodes.BadInvalidState
    moved = good.state.model_copy(update={"file": good.state.file.with_name("other.sqlite")})
    served.config = good.model_copy(update={"state": moved})
    assert await served.call("engineer") == ua.StatusCodes.BadInvalidState
    served.config = good
    assert await served.call("engineer") == 0
    await served.until_more("Boom")
    t = np.concatenate([samples.t for samples in served.samples["Boom"]])
    assert set(np.diff(t)) == {STEP_NS}
    said = [
        line for line in capsys.readouterr().out.splitlines() if "configuration refused" in line
    ]
    assert len(said) == 3
    for line, reason in zip(said, ("valves[0].name", "Nowhere", "state.file"), strict=True):
        assert reason in line


class Heard:
    """What a client's subscription was sent."""

    def __init__(self):
        self.events = asyncio.Queue()
        self.counts = {}

    def event_notification(self, event):
        self.events.put_nowait(event)

    def datachange_notification(self, node, value, data):
        name = str(node.nodeid.Identifier)
        self.counts[name] = self.counts.get(name, 0) + 1


async def test_sessions_stay_and_are_told_which_valves_came_and_went(served):
    boom, bucket, _ = served.config.valves
    swing = ValveConfig(name="Swing", estimators=(SLOW,))
    heard = Heard()
    async with patient(served.config.server.url) as client:
        subscription = await client.create_subscription(50, heard)
        kind = client.get_node(ua.NodeId(ua.ObjectIds.GeneralModelChangeEventType))
        await subscription.subscribe_events(client.nodes.server, kind)
        index = await client.get_namespace_index("urn:valvemap:service")
        residual = client.get_node(ua.NodeId("Boom.RLS.Residual", index))
        await subscription.subscribe_data_change(residual)
        served.config = served.config.model_copy(update={"valves": (swing, boom, bucket)})
        await served.reload.call()
        async with asyncio.timeout(30.0):
            event = await heard.events.get()
        verbs = {one.Affected.Identifier: one.Verb for one in event.Changes}
        assert (verbs["Swing"], verbs["Stick"]) == (1, 2)  # NodeAdded, NodeDeleted
        assert "Boom" not in verbs
        await served.until_more("Swing")
        before = heard.counts["Boom.RLS.Residual"]
        await until(lambda: heard.counts["Boom.RLS.Residual"] > before)
        assert await once_good(client.get_node(ua.NodeId("Swing.RLS.SampleCount", index))) > 0


async def test_what_fails_to_start_gives_way_and_sessions_stay(served, monkeypatch):
    start, failures = LiveService.start, [StorageError("disk: no room")]

    async def fails_once(self):
        if failures and any(plan.name == "Swing" for plan in self.identification.plans):
            raise failures.pop()
        await start(self)

    monkeypatch.setattr(LiveService, "start", fails_once)
    heard = Heard()
    async with patient(served.config.server.url) as client:
        subscription = await client.create_subscription(50, heard)
        kind = client.get_node(ua.NodeId(ua.ObjectIds.GeneralModelChangeEventType))
        await subscription.subscribe_events(client.nodes.server, kind)
        swing = ValveConfig(name="Swing", estimators=(SLOW,))
        served.config = served.config.model_copy(
            update={"valves": (*served.config.valves[:2], swing)}
        )
        await served.reload.call()
        verbs = []
        async with asyncio.timeout(60.0):
            for _ in range(2):
                event = await heard.events.get()
                verbs.append({one.Affected.Identifier: one.Verb for one in event.Changes})
        assert [(each["Swing"], each["Stick"]) for each in verbs] == [(1, 2), (2, 1)]
        await served.until_more("Stick")
        index = await client.get_namespace_index("urn:valvemap:service")
        assert await once_good(client.get_node(ua.NodeId("Stick.RLS.SampleCount", index))) > 0
    assert not failures


def test_another_address_or_security_is_another_server(config):
    def plan(**sections):
        return SimpleNamespace(config=config.model_copy(update=sections), given_settings=None)

    slower = config.server.model_copy(update={"results_interval_ms": 500.0})
    assert is_same_server(plan(), plan(server=slower, valves=()))
    elsewhere = config.server.model_copy(update={"url": "opc.tcp://127.0.0.1:4999/other/"})
    assert not is_same_server(plan(), plan(server=elsewhere))
    laxer = config.security.model_copy(update={"require_crl": False})
    assert not is_same_server(plan(), plan(security=laxer))


@pytest.mark.skipif(sys.platform == "win32", reason="SIGHUP")
def test_a_hang_up_has_the_file_read_again(tmp_path, start_rig):
    file, log, port = tmp_path / "service.toml", tmp_path / "log", free_port()
    rig_port, scenario = free_port(), tmp_path / "two.toml"
    scenario.write_text('valves = [{ name = "Boom" }, { name = "Bucket" }]', encoding="utf-8")
    rig = rig_url(rig_port)
    text = f"""
        source = {{ url = "{rig}", security = "None" }}
        server = {{ url = "{service_url(port)}" }}
        security = {{ pki = "{tmp_path}/pki", users = "{tmp_path}/users.json" }}
        state = {{ file = "{tmp_path}/state.sqlite" }}
    """
    valve = "[[valves]]\nname = '{}'\nestimators = [{{ kind = 'RLS' }}]\n"
    UserStore().save(tmp_path / "users.json")
    file.write_text(text + valve.format("Boom"), encoding="utf-8")
    with (
        start_rig(rig_port, "--scenario", str(scenario)),
        running("serve", "--config", str(file), log=log) as process,
    ):
        wait_for(log, "first results published", process)
        for written, said in (
            ("valves = 7", "configuration refused"),
            (text + valve.format("Boom") + valve.format("Bucket"), "configuration taken over"),
        ):
            file.write_text(written, encoding="utf-8")
            process.send_signal(signal.SIGHUP)
            wait_for(log, said, process)
