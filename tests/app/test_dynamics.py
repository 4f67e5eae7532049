"""Dynamics over OPC UA: a spool is found, and its slowing down is a finding."""

import dataclasses
import re

import pytest
from asyncua import ua

from guarded_opcua import Role
from guarded_opcua.security.users import UserStore
from support.processes import free_port, rig_url
from support.served import PASSWORD, patient, serving
from valvemap.app.serve import serve
from valvemap.config.estimators import RlsConfig
from valvemap.vocabulary.dynamics import DYNAMIC_QUANTITIES, DynamicsStatus
from valvemap.vocabulary.findings import FindingCode
from valvemap.vocabulary.statuses import Status

# A busy machine takes three times as long for a fit: the test's own bound says when it fails.
pytestmark = [pytest.mark.waits, pytest.mark.timeout(600)]

SCENARIO = """
name = "steps"
[excitation]
kind = "scattered"
hold_s = 0.4
[[valves]]
name = "Valvistor"
[valves.valve]
spool_hz = 8
"""


async def slow_down(url):
    """Halve the natural frequency of the rig's spool."""
    client = patient(url)
    client.set_user("operator")
    client.set_password("password")
    async with client:
        index = await client.get_namespace_index("urn:valvemap:rig")
        valve = client.get_node(ua.NodeId("Valvistor", index))
        inject = ua.NodeId("Valvistor.InjectFault", index)
        await valve.call_method(inject, "sluggish", -50.0, 0.0)


@pytest.fixture
def settings(open_server):
    users = UserStore()
    users.add("operator", Role.OPERATOR, PASSWORD)
    return dataclasses.replace(open_server, users=users)


async def test_a_spool_is_found_and_its_slowing_down_is_named(
    config, settings, start_rig, tmp_path
):
    scenario = tmp_path / "steps.toml"
    scenario.write_text(SCENARIO)
    port = free_port()
    valve = config.valves[0].model_copy(update={"estimators": (RlsConfig(),)})  # fits use no map
    dynamics = {"window_s": 25.0}
    config = config.model_copy(
        update={
            "source": config.source.model_copy(update={"url": rig_url(port)}),
            "dynamics": config.dynamics.model_copy(update=dynamics),
            "valves": (valve,),
        }
    )
    with start_rig(port, "--scenario", str(scenario)):
        async with serving(serve, config, settings, "Valvistor", "Dynamics.Status") as seen:
            assert await seen.value("Dynamics.Status") == DynamicsStatus.WAITING
            await seen.until("Dynamics.Status", lambda status: status == DynamicsStatus.OK)
            await check_values(seen, 8.0)
            assert FindingCode.DYNAMICS_CHANGE not in await seen.value("Diagnostics.FindingCodes")
            await slow_down(rig_url(port))
            await seen.until(
                "Diagnostics.FindingCodes", lambda codes: FindingCode.DYNAMICS_CHANGE in codes
            )
            await seen.until("Dynamics.NaturalFrequency", lambda f: abs(f - 4.0) < 0.3)
            (sentence,) = [
                one for one in await seen.value("Diagnostics.Findings") if "frequency" in one
            ]
            before = re.search(r"went from ([\d.]+) to", sentence)
            assert before is not None
            assert float(before[1]) == pytest.approx(8.0, rel=0.01)


async def check_values(seen, f):
    assert await seen.value("Dynamics.NaturalFrequency") == pytest.approx(f, rel=0.05)
    assert 0.0 < await seen.value("Dynamics.NaturalFrequencyStd") < 0.05 * f
    assert await seen.value("Dynamics.Damping") == pytest.approx(0.7, abs=0.07)
    assert await seen.value("Dynamics.SlewStatus") == Status.UNEXCITED
    assert await seen.value("Dynamics.T90") == pytest.approx(0.0525, abs=0.004)
    for quantity in DYNAMIC_QUANTITIES:
        assert f"{quantity.name} " in await seen.value("Dynamics.Reason")
