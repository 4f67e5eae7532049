"""Several valves, each with estimators of its own, and a required U that reaches its valve."""

import asyncio

import pytest
from pydantic import SecretStr

from support.processes import rig_url
from valvemap.app.build import build_identification
from valvemap.app.serve import serve
from valvemap.config.estimators import RlsConfig
from valvemap.config.valves import NodesConfig, ValveConfig
from valvemap.pipeline.operator_ports import Command

pytestmark = pytest.mark.waits

TWO_VALVES = """
name = "two"
time_factor = 10
excitation = { kind = "scattered", hold_s = 0.02 }
valves = [{ name = "Boom" }, { name = "Bucket" }]
"""


@pytest.fixture
def port(config):
    number = int(config.source.url.split(":")[2].split("/")[0])
    assert config.source.url == rig_url(number)
    return number


async def served_until(config, open_server, enough, on_samples=lambda _valve, _samples: None):
    """Run the service until ``enough(identification)``; return its identification."""
    identification, stop = build_identification(config), asyncio.Event()
    serving = asyncio.ensure_future(serve(config, stop, open_server, identification, on_samples))
    try:
        async with asyncio.timeout(90):
            while not enough(identification) and not serving.done():  # noqa: ASYNC110 - no event
                await asyncio.sleep(0.1)
    finally:
        stop.set()
        await serving
    return identification


def count(identification, valve, estimator):
    number = [plan.name for plan in identification.plans].index(valve)
    return identification.results.one(number).estimators[estimator].sample_count


async def test_two_valves_are_identified_side_by_side(
    config, open_server, port, start_rig, tmp_path
):
    scenario = tmp_path / "two.toml"
    scenario.write_text(TWO_VALVES, encoding="utf-8")
    quick, slow = RlsConfig(name="Quick", lam=0.99), RlsConfig(name="Slow", lam=1.0)
    valves = (
        ValveConfig(name="Boom", estimators=(quick, slow)),
        ValveConfig(name="Bucket", estimators=(slow,)),
    )
    config = config.model_copy(update={"valves": valves})
    with start_rig(port, "--scenario", str(scenario)):
        identification = await served_until(
            config, open_server, lambda i: count(i, "Bucket", "Slow") > 500
        )
    assert count(identification, "Boom", "Quick") == count(identification, "Boom", "Slow") > 400
    for valve in (0, 1):
        counters = identification.results.counters(valve)
        assert counters["gaps"] == counters["missing"] == counters["late"] == 0


async def test_the_required_voltage_reaches_the_valve(
    config, open_server, port, start_rig, quick_scenario
):
    (valve,) = config.valves
    nodes = NodesConfig.of_rig("Valvistor", commanded=True)
    operator = {"user": "operator", "password": SecretStr("password")}
    config = config.model_copy(
        update={
            "valves": (valve.model_copy(update={"nodes": nodes}),),
            "source": config.source.model_copy(update=operator),
        }
    )
    U = []

    def demanding(identification):
        identification.do(Command.of("demand", "Valvistor", 60.0, 100.0))
        identification.do(Command.of("arm", "Valvistor"))
        required = identification.results.one(0).inverse.required_U
        return U and U[-1] > 5.0 and abs(U[-1] - required) < 1.0

    with start_rig(port, "--scenario", quick_scenario):
        await served_until(config, open_server, lambda i: count(i, "Valvistor", "RLS") > 1500)
    with start_rig(port, "--scenario", "external"):
        await served_until(
            config, open_server, demanding, lambda _valve, samples: U.append(samples.U[-1])
        )
