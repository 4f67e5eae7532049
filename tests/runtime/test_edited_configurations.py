"""What a restart makes of learnt states after the configuration was edited, each edit in a row."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import structlog

from support.plant import as_changes, plant
from support.small_plant import FakeSink, FakeSource
from valvemap.app.build import build_identification
from valvemap.clock import ManualClock
from valvemap.config.models import Config
from valvemap.pipeline.data_changes import DataChanges
from valvemap.runtime.live import LiveService
from valvemap.runtime.live_settings import LiveSettings
from valvemap.storage.checkpoints import CheckpointFile

GPM = 3.785411784  # l/min
URL, OTHER_URL = "opc.tcp://127.0.0.1:4840/plant", "opc.tcp://127.0.0.1:4850/plant"
KEPT, CONVERTED, RESET = "kept", "converted", "reset"


def valve(name):
    nodes = {s: f"ns=2;s={name}.{s}" for s in ("U", "p1", "p2", "Q", "T", "sequence")}
    return {
        "name": name,
        "nodes": nodes,
        "signals": {},
        "estimators": [{"kind": "RLS"}, {"kind": "RML"}, {"kind": "RBF"}],
    }


def base():
    return {"source": {"url": URL}, "valves": [valve("V1"), valve("V2")]}


def edited(edit):
    given = copy.deepcopy(base())
    edit(given)
    return Config.model_validate(given)


def signal(name, **fields):
    def edit(given):
        given["valves"][0]["signals"][name] = fields

    return edit


def node(name, other):
    def edit(given):
        given["valves"][0]["nodes"][name] = other

    return edit


def both_pressures(**fields):
    def edit(given):
        given["valves"][0]["signals"].update(p1=fields, p2=fields)

    return edit


def swap_pressures(given):
    nodes = given["valves"][0]["nodes"]
    nodes["p1"], nodes["p2"] = nodes["p2"], nodes["p1"]


def swap_valves(given):
    one, other = given["valves"]
    one["nodes"], other["nodes"] = other["nodes"], one["nodes"]


def rename(given):
    given["valves"][0]["name"] = "Press"


def rename_and_gallons(given):
    rename(given)
    signal("Q", unit="gpm")(given)


def estimator(number, **fields):
    def edit(given):
        given["valves"][0]["estimators"][number].update(fields)

    return edit


def drop_estimator(given):
    del given["valves"][0]["estimators"][1]


def drop_valve(given):
    del given["valves"][0]


def new_valve(given):
    given["valves"].append(valve("V3"))


def no_T(given):
    del given["valves"][0]["nodes"]["T"]


def moved(given):
    given["source"]["url"] = OTHER_URL


def another_plant(given):
    """V1 comes from a second server with the same node ids; the first one is still configured."""
    del given["source"]
    given["sources"] = [{"name": "a", "url": URL}, {"name": "b", "url": OTHER_URL}]
    given["valves"][0]["source"], given["valves"][1]["source"] = "b", "a"


ALL = ("RLS", "RML", "RBF")
EDITS = {
    "nothing": (lambda _: None, dict.fromkeys(ALL, KEPT), ""),
    "Q in gpm": (
        signal("Q", unit="gpm"),
        {"RLS": CONVERTED, "RML": CONVERTED, "RBF": RESET},
        "Q was read as l/min, now as gpm",
    ),
    "Q scaled anew": (
        signal("Q", raw=(0, 100), range=(0, 378.5411784)),
        {"RLS": CONVERTED, "RML": CONVERTED, "RBF": RESET},
        "Q was read as l/min, now as [0, 100] raw for [0, 378.541] l/min",
    ),
    "Q as current loop": (
        signal("Q", unit="mA", raw=(4, 20), range=(0, 200)),
        dict.fromkeys(ALL, RESET),
        "now as [4, 20] mA for [0, 200] l/min",
    ),
    "Q against its sense": (
        signal("Q", raw=(0, 100), range=(0, -100)),
        dict.fromkeys(ALL, RESET),
        "Q was read as l/min",
    ),
    "pressures in psi": (
        both_pressures(unit="psi"),
        dict.fromkeys(ALL, RESET),
        "p1 was read as bar, now as psi",
    ),
    "one pressure in psi": (
        signal("p2", unit="psi"),
        dict.fromkeys(ALL, RESET),
        "p2 was read as bar, now as psi",
    ),
    "both pressures absolute": (  # their difference is the same
        both_pressures(raw=(0, 100), range=(-1.01325, 98.98675)),
        dict.fromkeys(ALL, KEPT),
        "p1 and p2 are shifted alike: kept",
    ),
    "U as ratio": (
        signal("U", unit="1"),
        dict.fromkeys(ALL, RESET),
        "U was read as %, now as 1",
    ),
    "T in °F": (signal("T", unit="°F"), dict.fromkeys(ALL, KEPT), "T is another"),
    "T from another node": (node("T", "ns=2;s=tank"), dict.fromkeys(ALL, KEPT), "T is another"),
    "no T": (no_T, dict.fromkeys(ALL, KEPT), "T came from ns=2;s=V1.T, now from no node"),
    "Q from another node": (
        node("Q", "ns=2;s=FT-7"),
        dict.fromkeys(ALL, RESET),
        "Q came from ns=2;s=V1.Q, now from ns=2;s=FT-7",
    ),
    "pressures swapped": (
        swap_pressures,
        dict.fromkeys(ALL, RESET),
        "the nodes of p1 and p2 are swapped",
    ),
    "another running number": (
        node("sequence", "ns=2;s=n"),
        dict.fromkeys(ALL, KEPT),
        "sequence came from",
    ),
    "valve renamed": (rename, dict.fromkeys(ALL, KEPT), "was V1.RLS: found again by its nodes"),
    "renamed, and Q in gpm": (
        rename_and_gallons,
        {"RLS": CONVERTED, "RML": CONVERTED, "RBF": RESET},
        "found again by its nodes; Q was read as l/min, now as gpm: converted",
    ),
    "estimator renamed": (
        estimator(0, name="Linear"),
        {"Linear": KEPT, "RML": KEPT},
        "was V1.RLS: found again by its settings",
    ),
    "another λ": (
        estimator(1, lam=0.99),
        dict.fromkeys(ALL, KEPT),
        "V1.RML: lam was 0.999, now 0.99: kept",
    ),
    "another rule of forgetting": (
        estimator(0, forgetting="exponential"),
        {"RLS": RESET, "RML": KEPT, "RBF": KEPT},
        "V1.RLS: it is a state of other hyper-parameters",
    ),
    "another estimator of that name": (
        estimator(1, kind="RBF", name="RML"),
        {"RLS": KEPT, "RML": RESET, "RBF": KEPT},
        "V1.RML: it is a state of",
    ),
    "estimator removed": (drop_estimator, {"RLS": KEPT, "RBF": KEPT}, "V1.RML: no such estimator"),
    "valve removed": (drop_valve, {}, "no such valve"),
    "valve added": (new_valve, dict.fromkeys(ALL, KEPT), ""),
    "accuracy of Q": (
        signal("Q", accuracy=0.5),
        dict.fromkeys(ALL, KEPT),
        "Q ± 0 is now ± 0.5: the map is kept",
    ),
    "server moved": (
        moved,
        dict.fromkeys(ALL, KEPT),
        f"its source was {URL}, now {OTHER_URL}: kept",
    ),
    "another server": (
        another_plant,
        dict.fromkeys(ALL, RESET),
        f"its source was {URL}, now {OTHER_URL}",
    ),
}


def of_both(samples):
    """The changes of V1 and of V2, whose flow is smaller."""
    one, other = as_changes(samples), as_changes(replace(samples, Q=0.5 * samples.Q))
    return DataChanges.concatenate([one, replace(other, item=other.item + np.int32(6))])


@pytest.fixture(scope="module")
def learnt():
    identification = build_identification(Config.model_validate(base()))
    identification.take(of_both(plant(400)))
    return identification


async def restarted(path, config):
    """Start the service on a file; return what it then knows, its log, and what is set aside."""
    identification = build_identification(config)
    with CheckpointFile(path) as store, structlog.testing.capture_logs() as logs:
        live = LiveService(
            *(identification, FakeSource(), FakeSink(), store, ManualClock(0), LiveSettings())
        )
        await live.start()
        await live.keep()
        aside = store.aside()
    words = [str(x) for log in logs for x in (log.get("why"), log.get("what")) if x]
    return identification, " | ".join(words), aside


@pytest.fixture
def path(tmp_path, learnt):
    with CheckpointFile(tmp_path / "state.sqlite") as store:
        store.save(learnt.states.kept())
    return tmp_path / "state.sqlite"


@pytest.mark.parametrize("name", EDITS)
async def test_a_state_is_used_under_its_own_meaning_alone(path, learnt, name):
    edit, expected, words = EDITS[name]
    after, said, aside = await restarted(path, edited(edit))
    assert words in said
    assert bool(said) == bool(words)
    first = after.plans[0].name
    put = {f"{one.checkpoint.valve}.{one.checkpoint.estimator}" for one in aside}
    for estimator_name, outcome in expected.items():
        was = "RLS" if estimator_name == "Linear" else estimator_name
        before = learnt.results.one(0).estimators[was]
        now = after.results.one(0).estimators[estimator_name]
        if outcome == RESET:
            assert now.sample_count == 0
            assert {f"V1.{was}", f"{first}.{was}"} & put
            continue
        scale = GPM if outcome == CONVERTED else 1.0
        n = 5  # of the structure; those of the noise have no unit
        assert now.sample_count == before.sample_count
        assert now.theta[:n] == pytest.approx(scale * before.theta[:n], rel=1e-9)
        assert not {f"V1.{was}", f"{first}.{was}"} & put
    untouched = after.plans[-1 if name != "valve added" else 1]
    if untouched.name == "V2":
        for estimator_name in ALL:
            assert np.array_equal(
                after.results.one(len(after.plans) - 1 - (name == "valve added"))
                .estimators[estimator_name]
                .theta,
                learnt.results.one(1).estimators[estimator_name].theta,
            )


async def test_a_converted_state_is_that_of_a_life_in_the_new_unit(path):
    after, _, _ = await restarted(path, edited(signal("Q", unit="gpm")))
    right = build_identification(edited(signal("Q", unit="gpm")))
    samples = plant(400)
    right.take(as_changes(replace(samples, Q=GPM * samples.Q)))
    more = plant(300, seed=5, first=400)
    for ours in (after, right):
        ours.take(as_changes(replace(more, Q=GPM * more.Q)))
    for name in ("RLS", "RML"):
        got, wanted = (one.results.one(0).estimators[name] for one in (after, right))
        assert got.theta == pytest.approx(wanted.theta, rel=1e-9)
        assert got.std == pytest.approx(wanted.std, rel=1e-9)
        assert got.residual_rmse == pytest.approx(wanted.residual_rmse, rel=1e-9)


async def test_valves_that_exchange_their_nodes_exchange_what_they_learnt(path, learnt):
    after, said, aside = await restarted(path, edited(swap_valves))
    for name in ALL:
        for now, before in ((0, 1), (1, 0)):
            assert np.array_equal(
                after.results.one(now).estimators[name].theta,
                learnt.results.one(before).estimators[name].theta,
            )
    assert "V1.RLS: was V2.RLS: found again by its nodes" in said
    assert not aside


async def test_an_edit_that_is_taken_back_finds_its_states_aside(path):
    _, _, aside = await restarted(path, edited(node("Q", "ns=2;s=FT-7")))
    assert {one.checkpoint.estimator for one in aside} >= set(ALL)
    assert all("FT-7" in one.reason for one in aside)
    _, _, again = await restarted(path, edited(node("Q", "ns=2;s=FT-7")))
    assert again == aside  # a second start sets nothing aside


async def test_a_renamed_valve_keeps_its_states_when_it_is_named_back(path, learnt):
    await restarted(path, edited(rename))
    after, said, aside = await restarted(path, edited(lambda _: None))
    assert "found again by its nodes" in said
    assert not aside
    for name in ALL:
        before = learnt.results.one(0).estimators[name]
        assert np.array_equal(after.results.one(0).estimators[name].theta, before.theta)


async def test_samples_in_the_reorder_buffer_are_converted_too(tmp_path):
    config = Config.model_validate(base())
    lost = np.r_[0 : 6 * 120, 6 * 122 : 6 * 200]  # a gap, behind which samples wait
    changes = as_changes(plant(200))
    changes = DataChanges(*(column[lost] for column in vars(changes).values()))
    before = build_identification(config)
    before.take(changes)
    assert before.arrivals.pending()[0] > 0
    with CheckpointFile(tmp_path / "state.sqlite") as store:
        store.save(before.states.kept())
    after, _, _ = await restarted(tmp_path / "state.sqlite", edited(signal("Q", unit="gpm")))
    assert after.arrivals.pending()[0] == before.arrivals.pending()[0]
    for one in (before, after):
        one.wait_no_longer(np.array([0]))
    got, wanted = (one.results.one(0).estimators["RLS"] for one in (after, before))
    assert got.theta == pytest.approx(GPM * wanted.theta, rel=1e-9)
