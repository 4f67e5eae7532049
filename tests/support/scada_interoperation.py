"""What a SCADA of any stack must find at our results server: types, alarms, trends.

A test module per stack subclasses :class:`ScadaInteroperation`, see :mod:`support.interoperation`.
"""

import asyncio

import numpy as np
from asyncua import ua

from support.interoperation import PERIOD_S, SAMPLES, VALVE, Codes, every_sample, taken
from support.plant import START
from valvemap.opcua_results.companions import DI, PADIM
from valvemap.opcua_results.results_server import NAMESPACE
from valvemap.pipeline.device_health import DeviceHealth

HAS_TYPE, HAS_SUBTYPE, HAS_CONDITION = "i=40", "i=45", "i=9006"
HAS_INTERFACE = "i=17603"
OBJECT_TYPES = f"i={ua.ObjectIds.BaseObjectType}"
TYPES = f"nsu={NAMESPACE};s=Types"
START_MS = START // 1_000_000
KEPT = 200  # samples, 10 ms apart


async def listed(operator, name, **wanted):
    """Wait until its alarm list shows an alarm so."""
    async with asyncio.timeout(30.0):
        while True:
            shown = {alarm["name"]: alarm for alarm in await operator.ask("alarms")}
            found = shown.get(name)
            if found is not None and wanted.items() <= found.items():
                return found
            await asyncio.sleep(0.05)


async def health(observer, expected):
    """Wait until the valve is so."""
    async with asyncio.timeout(30.0):
        while True:
            found = await observer.ask("read", node=f"{VALVE}.DeviceHealth")
            if (found["value"], found["code"]) == (int(expected), Codes.Good):
                return
            await asyncio.sleep(0.05)


async def past_of(observer, node, count, **more):
    """Wait until the history holds so much, and return what it says."""
    async with asyncio.timeout(30.0):
        while True:
            end = START_MS + 10 * KEPT
            asked = {"node": f"{VALVE}.{node}", "start": START_MS, "end": end, **more}
            found = await observer.ask("history", **asked)
            if len(found["values"]) >= count:
                return found
            await asyncio.sleep(0.1)


class ScadaInteroperation:
    """The list that every stack goes through."""

    async def test_it_browses_the_types_that_templates_are_bound_to(self, observer):
        of_valve = await observer.ask("browse", node=VALVE, reference=HAS_TYPE)
        of_estimator = await observer.ask("browse", node=f"{VALVE}.RLS", reference=HAS_TYPE)
        every = await observer.ask("browse", node=OBJECT_TYPES, reference=HAS_SUBTYPE)
        declared = await observer.ask("browse", node=f"{TYPES}.Estimator")
        assert of_valve["names"] == ["ValveType"]
        assert of_estimator["names"] == ["EstimatorType"]
        assert {"ValveType", "EstimatorType", "InverseMapType"} <= set(every["names"])
        assert {"Residual", "ParameterVector", "Predict"} <= set(declared["names"])

    async def test_it_finds_a_valves_conditions(self, observer):
        found = await observer.ask("browse", node=VALVE, reference=HAS_CONDITION)
        assert found["code"] == Codes.Good
        assert len(found["names"]) >= 9

    async def test_its_alarm_list_shows_acknowledges_comments_and_confirms(self, operator, stage):
        alarms = stage.live._parts.valves.fleets[0].alarms
        alarms.note_lags(np.array([0]), np.array([0.3]))
        await asyncio.sleep(2 * PERIOD_S)
        await operator.ask("watchAlarms")  # what stood before it came shows by a refresh
        state = {"active": True, "acked": False, "confirmed": True, "retain": True}
        found = await listed(operator, "LagFound", **state)
        assert found["source"] == "Valvistor"
        assert "lags by 0.3 s (limit 0.1 s)" in found["text"]
        for method, comment, after in (
            ("AddComment", "the filter's", {}),
            ("Acknowledge", "seen", {"acked": True, "confirmed": False}),
            ("Confirm", "done", {"confirmed": True}),
        ):
            done = await operator.ask("act", name="LagFound", method=method, comment=comment)
            assert done["code"] == Codes.Good
            state |= after
            await listed(operator, "LagFound", **state, comment=comment)
        again = await operator.ask("act", name="LagFound", method="Confirm", comment="")
        assert again["code"] == Codes.BadConditionBranchAlreadyConfirmed
        alarms.note_lags(np.array([0]), np.array([0.0]))
        await listed(operator, "LagFound", active=False, retain=False)

    async def test_it_reads_a_trend_page_by_page(self, observer):
        found = await past_of(observer, "Signals.Q", KEPT, page=60)
        expected = np.concatenate([taken(first).Q for first in range(0, KEPT, SAMPLES)])
        values = found["values"]
        assert [each["value"] for each in values] == expected.tolist()
        assert [each["time"] for each in values] == [START_MS + 10 * k for k in range(KEPT)]
        assert {each["code"] for each in values} == {Codes.Good}
        assert found["pages"] == 4

    async def test_it_reads_averages_and_extremes(self, observer):
        await past_of(observer, "Signals.Q", KEPT)
        Q = np.concatenate([taken(first).Q for first in range(0, KEPT, SAMPLES)]).reshape(4, 50)
        for name, expected in (
            ("Average", Q.mean(1)),
            ("Minimum", Q.min(1)),
            ("Maximum", Q.max(1)),
        ):
            aggregate = f"i={getattr(ua.ObjectIds, f'AggregateFunction_{name}')}"
            found = await past_of(observer, "Signals.Q", 4, aggregate=aggregate, interval=500.0)
            values = [each["value"] for each in found["values"]]
            np.testing.assert_allclose(values, expected, rtol=1e-12)

    async def test_what_has_no_history_says_so(self, observer):
        asked = {"start": START_MS, "end": START_MS + 1_000}
        found = await observer.ask("history", node=f"{VALVE}.RLS.ParameterVector", **asked)
        assert found["code"] == Codes.BadHistoryOperationUnsupported

    async def test_it_finds_valves_and_their_plates_by_the_names_of_devices(self, observer):
        device = [[DI, "DeviceSet"], [NAMESPACE, "Valvistor"]]
        plate = f"{VALVE}.Identification"
        for name, text in (("Manufacturer", "Muster AG"), ("Model", "V-100")):
            path = [*device, [DI, "Identification"], [DI, name]]
            found = await observer.ask("follow", node="i=85", path=path)
            assert found["targets"] == [f"Valvistor.Identification.{name}"]
            read = await observer.ask("read", node=f"{plate}.{name}")
            assert (read["value"], read["code"]) == (text, Codes.Good)
        unknown = await observer.ask("read", node=f"{plate}.SerialNumber")
        assert unknown["code"] == Codes.UncertainInitialValue
        of = await observer.ask("browse", node=plate, reference=HAS_TYPE)
        assert of["names"] == ["MachineryComponentIdentificationType"]
        interfaces = await observer.ask("browse", node=VALVE, reference=HAS_INTERFACE)
        assert interfaces["names"] == ["IDeviceHealthType"]

    async def test_it_finds_process_values_and_monitors_them(self, observer):
        of = await observer.ask("browse", node=f"{VALVE}.ProcessValues.Q", reference=HAS_TYPE)
        assert of["names"] == ["ProcessValueType"]
        device = [[DI, "DeviceSet"], [NAMESPACE, "Valvistor"]]
        path = [*device, [NAMESPACE, "ProcessValues"], [NAMESPACE, "Q"], [PADIM, "AnalogSignal"]]
        found = await observer.ask("follow", node="i=85", path=path)
        shown = "ProcessValues.Q.AnalogSignal"
        assert found["targets"] == [f"Valvistor.{shown}"]
        await observer.subscribe(every_sample(shown), every_sample("Signals.Q"))
        heard, plain = await observer.watch_until(5)
        both = min(len(heard), len(plain))  # a stack may subscribe one after the other
        assert both >= 3
        assert heard[-both:] == plain[-both:]

    async def test_it_reads_a_valves_health(self, observer, stage):
        path = [[DI, "DeviceSet"], [NAMESPACE, "Valvistor"], [DI, "DeviceHealth"]]
        found = await observer.ask("follow", node="i=85", path=path)
        assert found["targets"] == ["Valvistor.DeviceHealth"]
        alarms = stage.live._parts.valves.fleets[0].alarms
        for lag, expected in ((0.3, DeviceHealth.MAINTENANCE_REQUIRED), (0.0, DeviceHealth.NORMAL)):
            alarms.note_lags(np.array([0]), np.array([lag]))
            await health(observer, expected)
