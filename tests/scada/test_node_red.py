"""Node-RED with the flow of the how-to page, on a demo and on a service that asks who one is."""

import asyncio
import math

import pytest
from asyncua import ua

from support.node_red import flow, node_red, signed
from support.processes import run
from support.served import patient
from support.services import until_rejected

pytestmark = [pytest.mark.node, pytest.mark.timeout(900)]  # npm installs
SESSIONS = ua.ObjectIds.Server_ServerDiagnostics_ServerDiagnosticsSummary_CurrentSessionCount
SHOWN = (
    *("Signals.U", "Signals.dp", "Signals.Q"),
    *("Auto.PredictedFlow", "Auto.ResidualRmse", "Auto.Status", "RLS.PredictedFlow"),
    *(f"RLS.Parameters.a{i}" for i in range(1, 6)),
)
DEMAND, REQUIRED = "Valvistor.Inverse.FlowDemand", "Valvistor.Inverse.RequiredU"
DEMANDS, ASKS = ("valvemap.demand",), ("valvemap.ask",)


def status(shown, name):
    """The status of a value, None where there is none yet."""
    return shown.get(name, (None, None))[1]


def shows_what_the_valve_does(program):
    """All that is watched comes, is good and belongs together."""

    shown = program.once(
        lambda shown: all(status(shown, f"Valvistor.{name}") == "Good" for name in SHOWN)
    )
    values = {name.partition(".")[2]: value for name, (value, _) in shown.items()}
    assert all(math.isfinite(values[name]) for name in SHOWN)
    assert abs(values["Auto.PredictedFlow"] - values["Signals.Q"]) < 10.0  # l/min
    assert abs(values["RLS.Parameters.a4"] - 0.25) < 0.1


def demands_a_flow(program):
    """A flow is written, and the voltage for it read."""

    def answered(shown):
        return status(shown, DEMAND) == "Good" and status(shown, REQUIRED) == "Good"

    shown = program.once(answered, (*DEMANDS, *ASKS))
    assert 0.0 < shown[REQUIRED][0] < 100.0


@pytest.fixture(scope="module")
def program(tmp_path_factory, request):
    cache = request.config.cache.mkdir("scada")
    with node_red(tmp_path_factory.mktemp("node_red"), cache) as program:
        yield program


async def test_one_connection_shows_signals_prediction_and_parameters(program, demo):
    async with patient(demo.url) as client:
        program.deploy(flow(demo.url))
        shows_what_the_valve_does(program)
        with_it = await client.get_node(SESSIONS).read_value()
        program.deploy([])
        async with asyncio.timeout(20.0):
            while await client.get_node(SESSIONS).read_value() != with_it - 1:  # noqa: ASYNC110 - polled
                await asyncio.sleep(0.1)


def test_in_a_demo_nobody_writes_without_a_name_and_the_operator_does(program, demo):
    program.deploy(flow(demo.url))
    program.once(lambda shown: status(shown, DEMAND) == "BadUserAccessDenied", DEMANDS)
    operator = {"user": "operator", "password": demo.password}
    program.deploy(flow(demo.url, none=False, login=True, credentials=operator))
    demands_a_flow(program)


async def test_signed_and_encrypted_it_is_let_in_once_its_certificate_is_trusted(
    program, installation
):
    theirs = flow(installation.url, **signed("operator", installation.password))
    program.deploy(theirs)
    (rejected,) = until_rejected(installation)
    assert run("trust", rejected, env=installation.env).returncode == 0
    program.deploy(theirs)
    shows_what_the_valve_does(program)
    demands_a_flow(program)
