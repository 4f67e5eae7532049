"""A template of the configuration file, with the settings that are usually changed."""

from collections.abc import Sequence
from pathlib import Path

from valvemap.foreign_text import toml_string


def configuration_template(data: Path, host_names: Sequence[str] = ()) -> str:
    """Return a configuration (TOML) for the virtual rig; ``data``: folder of keys and states."""

    def quoted(thing: Path | Sequence[str]) -> str:
        if isinstance(thing, Path):
            return toml_string(str(thing))
        return f"[{', '.join(map(toml_string, thing))}]"

    return f"""\
# valvemap: what to identify, and where. Fields left out keep their defaults; any field can be
# overridden by the environment: VALVEMAP_SOURCE__URL=opc.tcp://plc:4840

[source] # the OPC UA server with the signals
url = "opc.tcp://127.0.0.1:4840/valvemap/rig/"
security = "Basic256Sha256" # or Aes256Sha256RsaPss; None only where the wire is your own
user = "service"
password_file = {quoted(data / "source-password")}
publishing_interval_ms = 100
# check_host_name = false # where the source's certificate does not name its host

# Several servers: [[sources]] with a name each, in place of [source]; then `source = "NAME"` in
# every [[valves]].

[server] # our own, with the results
url = "opc.tcp://127.0.0.1:4841/valvemap/service/"
host_names = {quoted(host_names)} # further names in its certificate
results_interval_ms = 0 # single variables at most as often, e.g. 1000 for SCADA; Frame has all

[security]
pki = {quoted(data / "pki" / "service")}
users = {quoted(data / "users.json")}
# require_crl = false # where authorities publish no revocation lists; self-signed ones need none

[state] # survives a restart
file = {quoted(data / "state.sqlite")}
checkpoint_interval_s = 10

[history] # what signals and results have been, for trends that reach back (HistoryRead)
file = {quoted(data / "history.sqlite")}
keep_days = 7 # values, and their summaries of 10 s
trend_days = 30 # summaries of 5 min
most_mb = 2000

# [mqtt] # where `valvemap mqtt` sends results, as Sparkplug B: docs/mqtt.md
# broker = "mqtts://broker.plant:8883"
# group = "valvemap"
# edge_node = "service"
# structure = "templates" # a valve is one tag with members; without it, a tag per variable

[alignment] # which signals make one sample
# How signals come that carry no common time is found at the start; these two say it instead.
# tolerance_ms = 6 # of the times of one sample
# hold_s = {{ T = 10 }} # a signal that reports less often than the others
# reorder_ms = 1000 # behind a hole in nodes.sequence; without one nothing waits unless given

[[valves]]
name = "Valvistor"
dp_range_bar = [0, 200]
Q_range_l_min = [0, 200]

[valves.nodes] # at the source: nsu=URI;s=NAME or ns=2;s=NAME
U = "nsu=urn:valvemap:rig;s=Valvistor.U"
p1 = "nsu=urn:valvemap:rig;s=Valvistor.p1"
p2 = "nsu=urn:valvemap:rig;s=Valvistor.p2"
Q = "nsu=urn:valvemap:rig;s=Valvistor.Q"
T = "nsu=urn:valvemap:rig;s=Valvistor.Temperature" # optional
sequence = "nsu=urn:valvemap:rig;s=Valvistor.Sequence" # optional: a running number per sample
# required_U = "nsu=urn:valvemap:rig;s=Valvistor.UCommand" # feed-forward: U for FlowDemand
# heartbeat = "nsu=urn:valvemap:rig;s=Valvistor.Heartbeat" # UInt32 that counts meanwhile

# [valves.ports] # in place of nodes: a valve with four edges, docs/ports.md
# U = "ns=2;s=V.U" # -100 … 100 %
# pP = "ns=2;s=V.pP" # and pT, pA, pB
# QA = "ns=2;s=V.QA" # and QB

# [valves.signals] # units and names of a plant's own, live and in recordings: docs/units.md
# U = {{ raw = [4, 20], range = [0, 100], column = "FCV-101.cmd" }} # mA, or counts: raw -> %
# p1 = {{ unit = "psi", accuracy = 15 }} # its sensor may be off by ± 15 psi
# p2 = {{ unit = "psi" }}
# Q = {{ unit = "gpm" }} # of the United States; "imp gpm"
# T = {{ unit = "°F" }}

# [valves.identification] # its name plate, for clients that know DI or Machinery
# manufacturer = "Muster AG"
# model = "V-100"
# serial_number = "4711"

# [valves.feed_forward] # once an operator has called Inverse.Arm
# range_percent = [0, 100] # never left
# slew_percent_per_s = 100 # never exceeded
# fallback = "hold" # or ramp (to fallback_percent), hand_back (to the source; needs heartbeat)
# fallback_percent = 0
# max_age_s = 0.5 # of the newest sample
# max_width_percent = 10 # of the 95 % interval of U
# lead = true # advance the demand by the identified delay of the spool

# [valves.gate.Q] # off unless given
# low = -5
# high = 250
# frozen_s = 5
# max_rate_per_s = 10000
# spike = 50

# [[valves.estimators]] # without any: RLS, RML, RBF and Auto
# kind = "RLS"
# name = "RLS"
# forgetting = "adaptive" # or exponential, directional, subspace, resetting, variable, window
# lam = 1.0
"""
