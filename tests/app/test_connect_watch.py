"""A server that takes no more monitored items still shows its valves."""

from valvemap.app import connect
from valvemap.errors import SourceRejected
from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.pipeline.data_changes import DataChanges
from valvemap.plant.candidates import Candidate
from valvemap.plant.grouping import group
from valvemap.plant.possible import possible_valves

MOST = 4  # nodes


async def test_what_may_be_a_valve_is_left_out_where_the_server_refuses_more(monkeypatch):
    names = ("Command [%]", "Inlet pressure [bar]", "Outlet pressure [bar]", "Flow [l/min]")
    rows = [("V1", name) for name in names] + [("X7", f"W{number}") for number in range(4)]
    numbers = [Candidate(f"s={'/'.join(path)}", path) for path in rows]
    groups = group(numbers)
    groups += possible_valves(numbers, groups)
    assert [one.name for one in groups] == ["V1", "X7"]

    async def changes(lots, watch_s):
        if len({node for lot in lots for _, _, node in lot.signals()}) > MOST:
            raise SourceRejected("BadTooManyMonitoredItems")
        return DataChanges.concatenate([])

    monkeypatch.setattr(connect, "OpcUaSource", lambda _settings, lots: lots)
    monkeypatch.setattr(connect, "changes_of", changes)
    found, refused = await connect._watch(SourceSettings("opc.tcp://plc:4840"), groups, 1.0)
    assert {"s=V1/Command [%]", "s=V1/Flow [l/min]"} <= set(found)
    (line,) = refused.values()
    assert line.startswith("X7: not watched beside the others, may be a valve: BadTooMany")
