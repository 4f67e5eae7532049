import asyncio
import time

import numpy as np
import pytest
from asyncua import ua

from guarded_opcua import Role, ServerSettings, UserStore
from support.served import patient
from valvemap_rig.directional import EDGES, OPENS, DirectionalValve, true_edge_flow
from valvemap_rig.fault_effects import ActiveFault
from valvemap_rig.faults import Fault, FaultError, commanded_fault
from valvemap_rig.machine import Controller, Cylinder, Machine
from valvemap_rig.machine_simulation import conditions
from valvemap_rig.scenario import BUILTIN, Scenario, ScenarioError, faultable, load_scenario
from valvemap_rig.server import RigServer
from valvemap_rig.simulation import Commands, advance, initial


def played(machine, seconds=20, rate=100.0, faults=(), **commands):
    scenario = Scenario(valves=(), machines=(machine,), faults=faults, sample_rate_hz=rate)
    state = initial(scenario, 0)
    _, block = advance(scenario, state, round(seconds * rate), Commands(**commands))
    return block.machines[machine.name]


def test_what_flows_in_moves_the_piston_or_compresses_the_oil():
    machine = Machine(valve=DirectionalValve(leakage_l_min_bar=0.0))
    truth = played(machine, rate=1000.0).truth
    cylinder = machine.cylinder
    leakage = cylinder.leakage_l_min_bar * (truth["pA"] - truth["pB"])
    beta = 1e4 * cylinder.bulk_modulus_GPa
    for line, area, sign in (("A", cylinder.A_A_cm2, 1), ("B", cylinder.A_B_cm2, -1)):
        x = truth["x"] if sign > 0 else cylinder.stroke_mm - truth["x"]
        V = cylinder.dead_A_l + 1e-4 * area * x
        p = truth[f"p{line}"]
        fine = p[1:-1] > 20  # bar; the free air does not count
        stored = 60.0 * V * np.gradient(p, 1e-3) / beta
        moved = sign * 6e-3 * area * truth["v"]
        off = (truth[f"Q{line}"] - sign * leakage - moved - stored)[1:-1][fine]
        assert np.sqrt(np.mean(off**2)) < 0.15  # l/min; of the differences over 1 ms


def test_a_line_has_the_flow_of_its_open_edge_less_the_leakage():
    machine = Machine()
    truth = played(machine).truth
    leakage = machine.valve.leakage_l_min_bar * (truth["pA"] - truth["pB"])
    flows = {
        edge: np.where(
            OPENS[edge] * truth["spool"] > 0,
            true_edge_flow(machine.valve, edge, truth["spool"], drop),
            0.0,
        )
        for edge, drop in (
            ("PA", truth["pS"] - truth["pA"]),
            ("AT", truth["pA"] - truth["pT"]),
            ("PB", truth["pS"] - truth["pB"]),
            ("BT", truth["pB"] - truth["pT"]),
        )
    }
    assert flows["PA"] - flows["AT"] - leakage == pytest.approx(truth["QA"], abs=0.2)
    assert flows["PB"] - flows["BT"] + leakage == pytest.approx(truth["QB"], abs=0.2)
    assert np.ptp(truth["spool"]) > 100


def test_friction_mass_and_load_balance_the_pressures():
    machine = Machine(cylinder=Cylinder(coulomb_N=0, stribeck_N=0))
    truth = played(machine, rate=1000.0).truth
    cylinder = machine.cylinder
    force = 10 * (cylinder.A_A_cm2 * truth["pA"] - cylinder.A_B_cm2 * truth["pB"])
    a = np.gradient(1e-3 * truth["v"], 1e-3)
    resisting = truth["load"] + cylinder.viscous_N_s_m * 1e-3 * truth["v"] + cylinder.mass_kg * a
    assert np.sqrt(np.mean((force - resisting)[1:-1] ** 2)) < 100  # N of some 10,000


def test_the_controller_follows_and_a_table_of_speeds_helps_it():
    def error(lead):
        truth = played(Machine(controller=Controller(lead=lead)), seconds=60).truth
        return float(np.sqrt(np.mean((truth["x"] - truth["xSet"]) ** 2)))

    alone, led = error("none"), error("table")
    assert led < 0.5 * alone
    assert led < 5


def test_an_end_stop_holds_the_piston_while_the_valve_is_open():
    machine = Machine(controller=None)
    truth = played(machine, seconds=10, U={"Spool": 60.0}).truth
    assert truth["x"][-1] == pytest.approx(machine.cylinder.stroke_mm, abs=2)
    assert truth["U"][-1] == 60
    assert abs(truth["v"][-100:]).max() < 1


def test_the_supply_sags_while_the_machine_takes_more():
    truth = played(Machine()).truth
    assert truth["pS"].min() < 175
    assert truth["pS"].max() <= 180.5


@pytest.mark.parametrize("edge", EDGES)
def test_damage_of_an_edge_is_of_that_edge_alone(edge):
    fault = ActiveFault(commanded_fault(f"damage.{edge}", -10, 0, faultable(Machine())), 5)
    now = conditions((fault,), np.arange(10), 100.0)
    assert now[:5].tolist() == conditions((), np.arange(5), 100.0).tolist()
    assert now[5:, EDGES.index(edge)] == pytest.approx(0.9)
    assert (np.delete(now[5:, :4], EDGES.index(edge), axis=1) == 1).all()


@pytest.mark.parametrize(
    ("kind", "size", "place", "value"),
    [("leakage", 2, 4, 3), ("air", 2, 5, 0.02), ("supply", -22, 6, 0.78), ("load", 100, 8, 2)],
)
def test_a_fault_of_the_machine_is_in_its_conditions(kind, size, place, value):
    fault = ActiveFault(Fault(kind=kind, size=size), 0)
    assert conditions((fault,), np.arange(2), 100.0)[1, place] == pytest.approx(value)


def test_air_softens_the_oil_and_more_leakage_slows_the_piston():
    sound = played(Machine(), seconds=30).truth
    for kind, size in (("air", 5), ("leakage", 10)):
        faulty = played(Machine(), seconds=30, faults=(Fault(kind=kind, size=size),)).truth
        assert abs(faulty["x"] - sound["x"]).max() > 0.5


@pytest.mark.parametrize(
    ("kind", "sentence"),
    [
        ("edge", r"kind 'edge': allowed are wear, damage, lag.*\.PA, \.AT, \.PB, \.BT"),
        ("damage.p1", "allowed are"),
        ("leakage.PA", "leakage is not of an edge"),
        ("offset.PA", "offset is not of an edge"),
    ],
)
def test_a_fault_that_a_machine_cannot_have_is_refused(kind, sentence):
    with pytest.raises(FaultError, match=sentence):
        commanded_fault(kind, 1.0, 0.0, faultable(Machine()))


def test_a_valve_with_one_edge_has_no_fault_of_a_machine():
    with pytest.raises(FaultError, match="allowed are wear"):
        commanded_fault("leakage", 1.0, 0.0)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("valves = []", "neither a valve nor a machine"),
        ("valves = []\n[[machines]]\n[fleet]\nvalves = 2", "fleet: .* no valve"),
        ("[[faults]]\nkind = 'leakage'", "Valvistor knows no leakage; allowed are wear"),
        ("[[faults]]\nkind = 'damage'\nedge = 'PA'", "Valvistor has no edge PA"),
        ("valves=[]\n[[machines]]\n[[faults]]\nkind='lag'\nsignal='x'", "Spool has no x; .* QB"),
        ("[[machines]]\nname = 'Valvistor'", "name 'Valvistor' is given twice"),
    ],
)
def test_a_scenario_that_does_not_fit_is_refused_in_one_line(tmp_path, text, sentence):
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ScenarioError, match=sentence) as caught:
        load_scenario(path)
    assert "\n" not in str(caught.value)


def test_a_machine_runs_at_least_twenty_times_as_fast_as_time():
    played(Machine(), seconds=0.1)  # compiles
    start = time.process_time()
    played(Machine(), seconds=20)
    assert time.process_time() - start < 1.0


@pytest.mark.asyncio
async def test_the_server_publishes_a_machine_and_takes_its_commands():
    users = UserStore()
    users.add("operator", Role.OPERATOR, "correct horse")
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/valvemap/rig/",
        application_uri="urn:test:valvemap:rig",
        application_name="valvemap rig",
        namespace_uri="urn:valvemap:rig",
        users=users,
        none_on_loopback=True,
    )
    machine = Machine(controller=Controller(lead="external"))
    scenario = BUILTIN["directional"].model_copy(update={"machines": (machine,)})
    async with await RigServer.create(settings, scenario) as server:
        playing = asyncio.create_task(server.run())
        client = patient(server.url)
        client.set_user("operator")
        client.set_password("correct horse")
        async with client:

            def node(name):
                return client.get_node(ua.NodeId(name, 2))

            scenarios = await node("Rig.Scenarios").read_value()
            assert scenarios == ["directional"]
            expected = {"U": ("%", -110), "pP": ("bar", -13.5), "QA": ("l/min", -181.5)}
            for name, (unit, low) in expected.items():
                properties = {
                    (await part.read_browse_name()).Name: await part.read_value()
                    for part in await node(f"Spool.{name}").get_properties()
                }
                assert properties["EngineeringUnits"].DisplayName.Text == unit
                assert properties["EURange"].Low == pytest.approx(low)
            await node("Spool.UCommand").write_value(-40.0)
            said = await node("Spool").call_method(
                node("Spool.InjectFault"), "damage.PB", -10.0, 0.0
            )
            assert said == "edge PB passes 10 % less; for good"
            for _ in range(250):
                await asyncio.sleep(0.02)
                if await node("Spool.QB").read_value() > 5:
                    break
            assert await node("Spool.QB").read_value() > 5
            names = ("U", "pP", "pT", "pA", "pB", "QA", "QB", "T", "Sequence")
            codes = {(await node(f"Spool.{n}").read_data_value()).StatusCode.value for n in names}
            assert codes == {0}
        playing.cancel()
        await asyncio.gather(playing, return_exceptions=True)
