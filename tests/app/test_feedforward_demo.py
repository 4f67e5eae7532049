"""Feed-forward over OPC UA: samples in, RequiredU out to the rig, the flow follows."""

import re

import pytest

from support.processes import free_port, rig_url, running, service_url

RATIOS = re.compile(r"(new, 40 °C|30 s after [^:]+): Valvistor ([\d.]+), FixedMap ([\d.]+)")


SLOW_MS = 150

pytestmark = pytest.mark.alone


def errors(tmp_path, *options, timeout):
    """What the demo's last line says: phase → (identified, fixed), l/min."""
    log = tmp_path / "demo.log"
    env = {
        "VALVEMAP_SOURCE__URL": rig_url(free_port()),
        "VALVEMAP_SERVER__URL": service_url(free_port()),
        "PYTHONUTF8": "1",
    }
    arguments = ("demo", "--scenario", "feedforward", *options)
    with running(*arguments, env=env, log=log) as process:
        assert process.wait(timeout) == 0
    text = log.read_text(encoding="utf-8")
    assert "Flow error, l/min RMS" in text
    age_ms = max(int(age) for age in re.findall(r"answers act after (\d+) ms", text))
    if age_ms > SLOW_MS:
        pytest.skip(f"this machine is too busy: answers act after {age_ms} ms")
    return {name: (float(own), float(fixed)) for name, own, fixed in RATIOS.findall(text)}


def test_the_valve_follows_the_demanded_flow(tmp_path):
    found = errors(tmp_path, "--duration", "13", timeout=150)
    identified, fixed = found["new, 40 °C"]
    assert identified < 2.5  # of up to 73 l/min, whatever else the machine has to do
    assert fixed < 4.0


@pytest.mark.soak
def test_after_damage_and_in_hot_oil_the_fixed_map_misses_five_times_more(tmp_path):
    found = errors(tmp_path, timeout=280)
    for phase in ("30 s after damage", "30 s after oil of 60 °C"):
        identified, fixed = found[phase]
        assert fixed > 5.0 * identified
