"""A fleet of valves on OPC UA that starts to play when somebody listens, and what it played."""

import numpy as np

from guarded_opcua import Role, ServerSettings, UserStore
from valvemap.model.samples import Samples
from valvemap_rig.fleet import record, valve_names
from valvemap_rig.fleet_server import FleetServer
from valvemap_rig.scenario import BUILTIN, Fleet

RIG = "urn:valvemap:rig"


def scenario_of(valves, seconds, rate_hz=100.0):
    """Scattered points, the same for whoever asks."""
    more = {
        "fleet": Fleet(valves=valves, loop_s=2.0),
        "duration_s": seconds,
        "sample_rate_hz": rate_hz,
    }
    return BUILTIN["scattered"].model_copy(update=more)


async def rig_of(scenario, folder):
    """The server of a fleet; the folder gets ``rig-password``, that of its user ``operator``."""
    users, password = UserStore.one_time("operator", Role.OPERATOR)
    (folder / "rig-password").write_text(password, encoding="utf-8")
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/valvemap/rig/",
        application_uri=RIG,
        application_name="valvemap rig",
        namespace_uri=RIG,
        users=users,
        none_on_loopback=True,
    )
    return await FleetServer.create(settings, scenario)


def played(scenario, times):
    """The samples of each valve by name; ``times`` are what a client heard, UTC ns."""
    signals = record(scenario).samples(0, scenario.samples)
    return {
        name: Samples.of(t=times, **dict(zip(("U", "p1", "p2", "Q", "T"), column, strict=True)))
        for name, column in zip(valve_names(scenario), np.moveaxis(signals, 0, -1), strict=True)
    }


def site_file(file, scenario, url, estimators=("RLS", "RML", "RBF"), more=""):
    """The configuration of a site with this fleet."""
    kinds = "".join(f"[[valves.estimators]]\nkind = '{kind}'\n" for kind in estimators)
    valves = "".join(
        f"[[valves]]\nname = '{name}'\n"
        "[valves.nodes]\n"
        + "".join(
            f"{signal} = 'nsu={RIG};s={name}.{last}'\n"
            for signal, last in (
                *((s, s) for s in ("U", "p1", "p2", "Q")),
                ("T", "Temperature"),
                ("sequence", "Sequence"),
            )
        )
        + kinds
        for name in valve_names(scenario)
    )
    password = file.parent / "rig-password"
    source = f"[source]\nurl = '{url}'\nsecurity = 'None'\nstartup_timeout_s = 60\n"
    source += f"user = 'operator'\npassword_file = '{password}'\n"
    file.write_text(source + more + valves, encoding="utf-8")
