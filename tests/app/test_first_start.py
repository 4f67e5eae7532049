"""SIGTERM while a first start imports and compiles: the service ends at once, with 0."""

import signal
import time

import pytest

from support.processes import free_port, rig_url, run, running, service_url

MOST_S = 10.0  # on a busy machine; a second is usual
pytestmark = [pytest.mark.waits, pytest.mark.timeout(180)]


@pytest.fixture(scope="module")
def env(tmp_path_factory):
    data = tmp_path_factory.mktemp("installed") / "data"
    found = {"VALVEMAP_OPERATOR_PASSWORD": "a long enough password", "VALVEMAP_DATA": str(data)}
    made = run("init", env=found)
    assert made.returncode == 0, made.stderr
    return found


@pytest.mark.parametrize("after_s", [1.0, 2.5, 8.0])
def test_a_first_start_ends_with_0(after_s, env, tmp_path):
    own = {
        **env,
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        "VALVEMAP_SERVER__URL": service_url(free_port()),
        "VALVEMAP_SOURCE__URL": rig_url(free_port()),
    }
    log = tmp_path / "service.log"
    config = f"{env['VALVEMAP_DATA']}/service.toml"
    with running("serve", "--config", config, env=own, log=log) as process:
        time.sleep(after_s)
        began = time.monotonic()
        process.send_signal(signal.SIGTERM)
        assert process.wait(MOST_S) == 0, log.read_text()
        assert time.monotonic() - began < MOST_S
    assert "Traceback" not in log.read_text(encoding="utf-8")
