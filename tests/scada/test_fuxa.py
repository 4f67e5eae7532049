"""FUXA with the project of the how-to page, on a demo and on a service that asks who one is."""

import math

import pytest
from asyncua import ua

from support import fuxa
from support.processes import run
from support.served import patient
from support.services import until_rejected

pytestmark = [pytest.mark.node, pytest.mark.timeout(900)]  # npm installs
SHOWN = (
    *("Signals.U", "Signals.p1", "Signals.p2", "Signals.dp", "Signals.Q", "Signals.T"),
    *("Auto.PredictedFlow", "Auto.Residual", "Auto.ResidualRmse"),
    *(f"RLS.Parameters.a{i}" for i in range(1, 6)),
)


@pytest.fixture
def program(tmp_path, request):
    with fuxa.fuxa(tmp_path, request.config.cache.mkdir("scada")) as program:
        yield program


async def break_sensors(demo):
    """Let the demo's sensors be of Bad quality for ten seconds."""
    client = patient(demo.rig)
    client.set_user("operator")
    client.set_password(demo.password)
    async with client:
        index = await client.get_namespace_index("urn:valvemap:rig")
        valve = client.get_node(ua.NodeId("Valvistor", index))
        inject = ua.NodeId("Valvistor.InjectFault", index)
        await valve.call_method(inject, "bad_quality", 1.0, 10.0)


@pytest.fixture
def password_file(tmp_path):
    def written(password):
        file = tmp_path / "password"
        file.write_text(f"{password}\n", encoding="utf-8")
        return str(file)

    return written


async def test_one_connection_shows_a_demo_its_alarms_and_what_flow_is_demanded(
    program, demo, password_file
):
    program.load(demo.url, "--user", "operator", "--password-file", password_file(demo.password))
    shows_what_the_valve_does(program)
    demands_a_flow(program)
    program.load(demo.url)  # keeps what is there
    assert program.values()["Inverse.FlowDemand"] == 60.0
    await break_sensors(demo)
    values = program.once(lambda values: "SensorLost" in program.alarms())
    assert values["Alarms.SensorLost.Text"]


def test_signed_and_encrypted_it_is_let_in_once_its_certificate_is_trusted(
    program, installation, password_file
):
    who = ["--user", "operator", "--password-file", password_file(installation.password)]
    program.load(installation.url, "--security", "Basic256Sha256", *who)
    (rejected,) = until_rejected(installation)
    assert run("trust", rejected, env=installation.env).returncode == 0
    shows_what_the_valve_does(program)
    demands_a_flow(program)


def shows_what_the_valve_does(program):
    """All values come, belong together and raise no alarm."""
    program.once(lambda values: all(is_number(values[name]) for name in SHOWN))
    values = program.once(belong_together)  # the program takes each value in its own moment
    assert abs(values["RLS.Parameters.a4"] - 0.25) < 0.1
    assert "SensorLost" not in program.alarms()


def demands_a_flow(program):
    """A flow is written, and the voltage for it read."""
    program.write("Inverse.FlowDemand", 60.0)
    program.write("Inverse.PressureDrop", 100.0)
    values = program.once(lambda values: is_number(values["Inverse.RequiredU"]))
    assert 0.0 < values["Inverse.RequiredU"] < 100.0


def belong_together(values):
    """Whether signals and prediction are of one sample."""
    of_one_sample = abs(values["Signals.p1"] - values["Signals.p2"] - values["Signals.dp"]) < 1e-6
    return of_one_sample and abs(values["Auto.PredictedFlow"] - values["Signals.Q"]) < 5.0  # l/min


def is_number(value):
    return value is not None and math.isfinite(float(value))
