"""The demo as a newcomer meets it: a process, two endpoints, any OPC UA client."""

import asyncio
import signal
import sys

import numpy as np
import pytest
from asyncua import ua

from support.processes import free_port, is_open, rig_url, running, service_url, wait_for
from support.served import patient
from valvemap.vocabulary.statuses import InverseStatus

pytestmark = pytest.mark.waits


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    log = tmp_path_factory.mktemp("demo") / "demo.log"
    rig, service = free_port(), free_port()
    env = {"VALVEMAP_SOURCE__URL": rig_url(rig), "VALVEMAP_SERVER__URL": service_url(service)}
    with running("demo", env=env, log=log) as process:
        password = wait_for(log, "password", process).split()[-1]
        wait_for(log, "samples; RMSE", process)
        yield {"rig": rig, "service": service, "password": password, "log": log}
    assert process.returncode == 0
    assert "Verification against the rig's noise-free truth" in log.read_text(encoding="utf-8")
    assert not is_open(rig), "the rig outlived the demo"


@pytest.fixture
async def service(demo):
    async with patient(service_url(demo["service"])) as client:
        yield client


@pytest.fixture
async def operator(demo):
    client = patient(service_url(demo["service"]))
    client.set_user("operator")
    client.set_password(demo["password"])
    async with client:
        yield client


async def node(client, name):
    index = await client.get_namespace_index("urn:valvemap:service")
    return client.get_node(ua.NodeId(name, index))


async def test_both_servers_are_browsed_from_their_objects(demo, service):
    index = await service.get_namespace_index("urn:valvemap:service")
    path = [f"{index}:{name}" for name in ("Identification", "Valvistor", "RLS", "ParameterVector")]
    found = await service.nodes.objects.get_child(path)
    assert found.nodeid == ua.NodeId("Valvistor.RLS.ParameterVector", index)
    async with patient(rig_url(demo["rig"])) as rig:
        index = await rig.get_namespace_index("urn:valvemap:rig")
        path = [f"{index}:{name}" for name in ("TestRig", "Valvistor", "p1")]
        found = await rig.nodes.objects.get_child(path)
        unit = await (await found.get_child("0:EngineeringUnits")).read_value()
        assert (unit.DisplayName.Text, unit.UnitId) == ("bar", 4342098)


async def test_a_parameter_vector_moves_while_it_is_watched(service):
    seen = []

    class Handler:
        def datachange_notification(self, _node, value, data):
            if value is not None:  # before the first update
                seen.append((value, data.monitored_item.Value.SourceTimestamp))

    subscription = await service.create_subscription(100, Handler())
    await subscription.subscribe_data_change(await node(service, "Valvistor.RLS.ParameterVector"))
    async with asyncio.timeout(40):  # cold kernels and a busy machine learn later
        while len(seen) < 5 or abs(seen[-1][0][3] - 0.25) >= 0.1:  # noqa: ASYNC110
            await asyncio.sleep(0.05)  # a subscription has no event of its own
    await subscription.delete()
    values = np.array([value for value, _ in seen])
    times = [time for _, time in seen]
    assert values.shape[1] == 5
    assert (np.ptp(values, axis=0) > 0).all()
    assert times == sorted(times)


async def test_results_carry_units_names_and_meaning(service):
    names = await (await node(service, "Valvistor.RLS.ParameterNames")).read_value()
    assert names == ["a1", "a2", "a3", "a4", "a5"]
    flow = await node(service, "Valvistor.RLS.PredictedFlow")
    unit = await (await flow.get_child("0:EngineeringUnits")).read_value()
    assert unit.UnitId == 19506
    status = await node(service, "Valvistor.RLS.Status")
    texts = await (await status.get_child("0:EnumStrings")).read_value()
    assert texts[await status.read_value()].Text
    assert (await status.read_data_type_as_variant_type()) is ua.VariantType.Int32


async def test_anyone_may_ask_for_a_flow_and_for_the_voltage_that_gives_it(service):
    inverse = await node(service, "Valvistor.Inverse")
    U, lower, upper, status = await inverse.call_method(
        await node(service, "Valvistor.Inverse.Invert"), 60.0, 100.0, 40.0
    )
    assert status in (InverseStatus.OK, InverseStatus.EXTRAPOLATING)  # as far as it has got
    assert lower <= U <= upper
    Q, std, _ = await (await node(service, "Valvistor.Auto")).call_method(
        await node(service, "Valvistor.Auto.Predict"), U, 100.0, 40.0
    )
    assert abs(Q - 60.0) < 0.5  # the map moves on between the two calls
    assert std > 0


async def test_nobody_without_a_name_writes_or_commands(service):
    demand = await node(service, "Valvistor.Inverse.FlowDemand")
    with pytest.raises(ua.UaStatusCodeError):
        await demand.write_value(50.0)
    with pytest.raises(ua.UaStatusCodeError):
        await (await node(service, "Valvistor.Auto")).call_method(
            await node(service, "Valvistor.RLS.Reset")
        )


HARMLESS = {"Predict", "PredictMeasurement", "Invert", "Compare"}


@pytest.mark.parametrize("server", ["rig", "service"])
async def test_no_variable_takes_a_value_from_nobody_and_no_method_a_command(demo, server):
    url = rig_url(demo["rig"]) if server == "rig" else service_url(demo["service"])
    async with patient(url) as client:
        index = await client.get_namespace_index(f"urn:valvemap:{server}")
        waiting, variables, methods = [client.nodes.objects], [], []
        while waiting:
            for child in await waiting.pop().get_children_descriptions():
                if child.NodeId.NamespaceIndex != index:
                    continue
                waiting.append(client.get_node(child.NodeId))
                of = {ua.NodeClass.Variable: variables, ua.NodeClass.Method: methods}
                of.get(child.NodeClass, []).append((waiting[-1], child.BrowseName.Name))
        assert len(variables) > 20
        for variable, _ in variables:
            value = await variable.read_data_value(raise_on_bad_status=False)
            with pytest.raises(ua.UaStatusCodeError):
                await variable.write_value(ua.DataValue(value.Value))
        for method, name in methods:
            allowed = await method.read_attribute(ua.AttributeIds.UserExecutable)
            assert allowed.Value.Value == (name in HARMLESS), name


async def test_an_operator_demands_a_flow_and_gets_a_voltage(operator):
    await (await node(operator, "Valvistor.Inverse.FlowDemand")).write_value(50.0)
    await (await node(operator, "Valvistor.Inverse.PressureDrop")).write_value(100.0)
    required = await node(operator, "Valvistor.Inverse.RequiredU")
    async with asyncio.timeout(30):
        while True:
            data = await required.read_data_value(raise_on_bad_status=False)
            if data.StatusCode.is_good() and 0 < data.Value.Value < 100:
                break
            await asyncio.sleep(0.1)
    ends = [await node(operator, f"Valvistor.Inverse.RequiredU{end}") for end in ("Lower", "Upper")]
    lower, U, upper = await operator.read_values([ends[0], required, ends[1]])
    assert lower < U < upper < lower + 20


async def test_an_operator_freezes_resets_and_is_told_what_is_wrong(operator):
    lane = await node(operator, "Valvistor.RML")
    await lane.call_method(await node(operator, "Valvistor.RML.Reset"))
    await lane.call_method(await node(operator, "Valvistor.RML.Freeze"))
    await lane.call_method(await node(operator, "Valvistor.RML.Resume"))
    factor = await node(operator, "Valvistor.RML.SetForgettingFactor")
    await lane.call_method(factor, 0.995)
    with pytest.raises(ua.UaStatusCodeError):
        await lane.call_method(factor, 1.5)
    with pytest.raises(ua.UaStatusCodeError):
        await lane.call_method(factor, "fast")


async def test_nothing_is_lost_on_the_way(service):
    gaps = await node(service, "Valvistor.Diagnostics.Gaps")
    assert await gaps.read_value() == 0


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no kill -9 to survive")
def test_a_demo_that_is_killed_leaves_no_rig_behind(tmp_path):
    log = tmp_path / "demo.log"
    rig, service = free_port(), free_port()
    env = {"VALVEMAP_SOURCE__URL": rig_url(rig), "VALVEMAP_SERVER__URL": service_url(service)}
    with running("demo", env=env, log=log) as process:
        wait_for(log, "Ctrl-C", process)
        process.send_signal(signal.SIGKILL)
        process.wait()
        for _ in range(100):
            if not is_open(rig):
                break
            signal.sigtimedwait([], 0.1)
        assert not is_open(rig)


def test_a_demo_ends_by_itself_after_its_duration(tmp_path):
    log = tmp_path / "demo.log"
    env = {
        "VALVEMAP_SOURCE__URL": rig_url(free_port()),
        "VALVEMAP_SERVER__URL": service_url(free_port()),
    }
    with running("demo", "--duration", "1", env=env, log=log) as process:
        assert process.wait(120) == 0
