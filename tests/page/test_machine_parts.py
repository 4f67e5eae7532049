"""Lines and axes: found beside the valves, and read while they are in view, as described."""

import math

import pytest

from support.shown_parts import AXIS, LINE
from support.shown_service import ShownService
from valvemap.clock import SystemClock
from valvemap.page.commands import carry_out
from valvemap.page.greeting import greeting
from valvemap.page.log_ins import LogIn
from valvemap.page.ports import Wanted
from valvemap.page.questions import Senseless, answer_to
from valvemap.page.settings import PageSettings
from valvemap.page.web import Page

EDGES = ("Boom.PA", "Boom.AT")


async def observed(**shown):
    service = ShownService(names=EDGES, lines=("Boom.LineA",), axes=("Press",), **shown)
    page = Page(service, lambda *_: (service, None), PageSettings(), SystemClock())
    await page.observer._discover()
    return page.observer, service


async def test_lines_and_axes_are_found_beside_the_edges():
    observer, _ = await observed()
    told = greeting(observer)
    found = [(v["name"], v["family"], v["kind"]) for v in told["valves"]]
    assert found == [*((e, "Boom", "") for e in EDGES), ("Boom.LineA", "Boom", "line")]
    assert told["parts"] == [{"name": "Press", "kind": "axis", "family": ""}]
    assert told["words"]["codes"]["axis"]["Status"][0][1] == "ok"


@pytest.mark.parametrize(("number", "known"), [(2, LINE), (3, AXIS)])
async def test_all_variables_of_a_part_in_view_are_read_and_no_other_s(number, known):
    observer, service = await observed()
    wanted = Wanted(parts={number})
    await observer._watch_parts(wanted)
    await observer._look_around(wanted, thoroughly=False)
    names = observer.store.get(number, "Described.Names").value
    assert set(names) == set(known) - {"Frame", "FrameNames", "Leak.PredictedFlow"}
    for name in names:
        value = observer.store.get(number, name).value
        assert value == known[name] or (math.isnan(value) and math.isnan(known[name]))
    before = service.reads
    await observer._look_around(Wanted(), thoroughly=False)
    assert service.reads - before == 2 * len(observer.valves)


async def test_the_units_and_sentences_are_those_of_the_nodes():
    observer, _ = await observed()
    await observer._watch_parts(Wanted(parts={3}))
    names, units, sentences = (
        observer.store.get(3, f"Described.{what}").value for what in ("Names", "Units", "Sentences")
    )
    described = dict(zip(names, zip(units, sentences, strict=True), strict=True))
    assert described["BulkModulus"] == ("", "Bulk modulus of oil and hoses, GPa.")
    assert described["Inverse.SpeedDemand"][0] == "mm/s"


async def test_a_speed_is_asked_of_an_axis_alone_and_a_flow_of_valves_and_lines():
    observer, service = await observed()
    assert '"U":25.0' in await answer_to(observer, 1, {"invert": "Press", "v": 100})
    assert service.calls[-1][:2] == ("Press.Inverse", "Invert")
    assert len(service.calls[-1][2][0]) == 6
    assert '"U":10.0' in await answer_to(observer, 1, {"invert": "Boom.LineA", "Q": 20, "dp": 9})
    for wrong in ({"invert": "Boom.PA", "v": 1}, {"invert": "Press", "Q": 1, "dp": 1}):
        with pytest.raises(Senseless):
            await answer_to(observer, 1, wrong)


async def test_a_speed_is_demanded_and_withdrawn():
    _, service = await observed()
    log_in = LogIn("operator", service, None, 0.0)
    await carry_out(log_in, {"demand": "Press", "v": 120})
    await carry_out(log_in, {"demand": "Press", "v": None})
    (first, withdrawn) = service.writes
    assert first == ("Press.Inverse.SpeedDemand", 120.0)
    assert math.isnan(withdrawn[1])
