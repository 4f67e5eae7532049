import asyncio

import numpy as np
import pytest
from asyncua import ua

from guarded_opcua import ServerSettings
from support.served import patient
from valvemap_rig.fleet import record, valve_names
from valvemap_rig.fleet_server import FleetServer
from valvemap_rig.scenario import BUILTIN, Fleet, Scenario

SCENARIO = BUILTIN["scattered"].model_copy(update={"fleet": Fleet(valves=12, loop_s=2.0)})


def settings():
    return ServerSettings(
        url="opc.tcp://127.0.0.1:0/valvemap/rig/",
        application_uri="urn:test:valvemap:rig",
        application_name="valvemap rig",
        namespace_uri="urn:valvemap:rig",
        none_on_loopback=True,
    )


def test_a_fleet_plays_the_same_samples_in_whatever_blocks_they_are_asked_for():
    recording = record(SCENARIO)
    whole = recording.samples(190, 30)
    parts = [recording.samples(190, 7), recording.samples(197, 23)]
    assert np.array_equal(whole, np.concatenate(parts))
    assert np.array_equal(record(SCENARIO).samples(190, 30), whole)


def test_every_valve_plays_the_recording_from_a_place_of_its_own_with_its_own_noise():
    recording = record(SCENARIO)
    first = recording.samples(0, 50)[..., 3]
    assert len({tuple(column) for column in first.T}) == 12
    noise = recording.samples(0, 200) - recording.samples(200, 200)  # the loop is 200 samples long
    assert 0.3 < noise[..., 3].std() / np.sqrt(2) < 0.5
    assert np.all(noise[..., 0] == 0.0)


def test_what_a_fleet_plays_is_the_flow_of_the_bench():
    alone = record(Scenario(fleet=Fleet(valves=1), sensors=SCENARIO.sensors))
    U, p1, p2, Q, T = alone.samples(0, 500)[:, 0].T
    assert np.all((U >= 0) & (U <= 100))
    assert np.all(p1 - p2 > -1.0)
    assert np.all((Q > -5) & (Q < 210))
    assert np.all((T > 10) & (T < 80))


@pytest.mark.parametrize("valves", [9, 10, 1000])
def test_the_names_of_a_fleet_sort_as_they_count(valves):
    names = valve_names(Scenario(fleet=Fleet(valves=valves)))
    assert len(set(names)) == valves
    assert names == sorted(names)


class Recorded:
    def __init__(self):
        self.values = {}

    def datachange_notification(self, node, _, data):
        self.values.setdefault(node.nodeid.Identifier, []).append(data.monitored_item.Value)


@pytest.mark.waits
@pytest.mark.asyncio
async def test_a_client_gets_every_sample_of_a_fleet_with_one_time_for_all_signals_of_a_valve():
    scenario = SCENARIO.model_copy(update={"duration_s": 1.5})
    async with await FleetServer.create(settings(), scenario) as fleet:
        async with patient(fleet.url) as client:
            recorded = Recorded()
            subscription = await client.create_subscription(100, recorded)
            names = [f"Valvistor07.{last}" for last in ("Sequence", "U", "p1", "Q", "Temperature")]
            nodes = [client.get_node(ua.NodeId(name, 2)) for name in names]
            await subscription.subscribe_data_change(nodes, queuesize=1_000)
            await fleet.run()
            await asyncio.sleep(0.3)
            count = await client.get_node(ua.NodeId("Rig.SampleCount", 2)).read_value()
            newest = await nodes[0].read_value()
        assert not fleet.playing
        assert fleet.samples == 150 >= count > 0
        assert fleet.lost == 0
    good = {
        name: [value for value in values if value.StatusCode.is_good()]
        for name, values in recorded.values.items()
    }
    assert [value.Value.Value for value in good["Valvistor07.Sequence"]] == list(range(150))
    assert newest == 149
    times = [value.SourceTimestamp for value in good["Valvistor07.Sequence"]]
    assert [value.SourceTimestamp for value in good["Valvistor07.Q"]] == times
    expected = record(scenario).samples(0, 150)[:, 6, 3]
    assert [value.Value.Value for value in good["Valvistor07.Q"]] == expected.tolist()
