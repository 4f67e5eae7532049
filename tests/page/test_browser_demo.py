"""The demo in a browser: real numbers that move, real demands, real faults."""

import asyncio

import pytest
import pytest_asyncio

from support.browser import tab
from support.processes import free_port, rig_url, running, service_url, wait_for
from valvemap.opcua_client.results_client import ResultsClient
from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.opcua_results.results_server import NAMESPACE

pytestmark = [pytest.mark.chromium, pytest.mark.asyncio(loop_scope="session")]

MOVES = {
    "valve/Valvistor": ".estimators tr[data-estimator=Auto]",
    "overview": ".rows tbody tr:has(a)",
    "commissioning/Valvistor": "li[data-done] >> nth=3",
}


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    log = tmp_path_factory.mktemp("demo") / "demo.log"
    port, service = free_port(), service_url(free_port())
    env = {
        "VALVEMAP_SOURCE__URL": rig_url(free_port()),
        "VALVEMAP_SERVER__URL": service,
        "VALVEMAP_PAGE_LISTEN": f"127.0.0.1:{port}",
    }
    with running("demo", env=env, log=log) as process:
        password = wait_for(log, "password", process).split()[-1]
        assert wait_for(log, "page", process).split()[-1] == f"http://127.0.0.1:{port}"
        wait_for(log, "samples; RMSE", process)
        yield f"http://127.0.0.1:{port}", service, password


@pytest_asyncio.fixture(scope="module", loop_scope="session")
async def visitor(browser, demo):
    url, _, password = demo
    async with tab(browser, url, password) as visitor:
        yield visitor
        assert visitor.problems == []


@pytest_asyncio.fixture(scope="module", loop_scope="session")
async def nodes(demo):
    client = ResultsClient(SourceSettings(url=demo[1]), NAMESPACE)
    await client.connect()
    yield client
    await client.close()


@pytest.mark.parametrize("view", MOVES)
async def test_every_view_shows_data_that_change(visitor, view):
    await visitor.open(view)
    moving = visitor.page.locator(MOVES[view]).first
    await moving.wait_for()
    seen = set()
    async with asyncio.timeout(60):
        while len(seen) < 3:
            seen.add(await moving.inner_text())
            await asyncio.sleep(0.2)


async def test_the_slider_changes_the_u_that_is_shown_and_it_is_the_service_s(visitor, nodes):
    await visitor.open("map/Valvistor")
    shown = visitor.page.locator(".answer .value[data-u]")
    await shown.wait_for()
    for flow in ("30", "90"):
        slider = visitor.page.locator(".inverse input[type=range]").first
        await slider.fill(flow)
        answered = visitor.page.locator(f".answer .value[data-for='{flow}@100']")
        await answered.wait_for()
        U = float(await answered.get_attribute("data-u"))
        inputs = [(float(flow), 100.0, float("nan"))]
        ((own, *_),) = await nodes.call("Valvistor.Inverse", "Invert", inputs)
        assert pytest.approx(own, abs=0.5) == U  # the map moves on between the two questions
    await visitor.page.locator(".surface canvas").first.wait_for()


async def test_an_operator_s_demand_moves_required_u_and_stands_on_the_time_line(visitor, nodes):
    await visitor.open("map/Valvistor")
    await visitor.log_in()
    slider = visitor.page.locator(".inverse input[type=range]").first
    required = []
    for flow in ("40", "80"):
        await slider.fill(flow)
        await visitor.page.locator("button", has_text="Write as FlowDemand").click()
        written = f"Written: FlowDemand {flow}.0 l/min"
        await visitor.page.locator("[role=status]", has_text=written).wait_for()
        await asyncio.sleep(1.0)
        (U,) = await nodes.read(["Valvistor.Inverse.RequiredU"])
        required.append(U.value)
    assert 0 < required[0] < required[1] < 100
    await visitor.open("timeline")
    await visitor.page.locator(".events li", has_text="operator: Inverse demand 80").wait_for()


async def test_a_fault_that_is_injected_on_the_page_appears_on_the_time_line(visitor):
    await visitor.open("rig/Valvistor")
    await visitor.page.locator("select[name=kind]").select_option("bad_quality")
    await visitor.page.locator("input[name=duration]").fill("20")
    await visitor.page.locator("button", has_text="Inject").click()
    await visitor.page.locator(
        "[role=status]", has_text="Injected: Samples of Bad quality"
    ).wait_for()
    await visitor.open("timeline")
    event = visitor.page.locator(".events li[data-kind=status]", has_text="Valvistor")
    await event.first.wait_for(timeout=30_000)
    await visitor.open("overview")
    badge = visitor.page.locator(".rows .badge[data-severity='3'], .rows .badge[data-severity='2']")
    await badge.first.wait_for()
