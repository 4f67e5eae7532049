"""SIGTERM while a first start imports and compiles: the service ends at once, with 0."""

import os
import signal
import subprocess
import sys
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


_ENDING = """
import threading, time
from multiprocessing import util
from valvemap.app.warm_up import _helpers
from valvemap.config.loading import load_config

spawn, starting, config = util.spawnv_passfds, threading.Event(), load_config()

def slowly(path, arguments, fds):
    number = spawn(path, arguments, fds)
    if any("spawn_main" in str(one) for one in arguments):
        starting.set()
        time.sleep(0.5)
    return number

def help_us():
    with _helpers(config, 1, 0):
        pass

util.spawnv_passfds = slowly
threading.Thread(target=help_us, daemon=True).start()
starting.wait()
"""


def test_an_end_while_another_process_is_started_leaves_it_its_arguments():
    ended = subprocess.run(
        [sys.executable, "-c", _ENDING], check=False, capture_output=True, text=True
    )
    assert (ended.returncode, ended.stderr) == (0, "")


_INTERRUPTED = """
import os, signal, time
from multiprocessing import util
from valvemap.app.warm_up import _helpers
from valvemap.config.loading import load_config

spawn = util.spawnv_passfds

def interrupted(path, arguments, fds):
    number = spawn(path, arguments, fds)
    if any("spawn_main" in str(one) for one in arguments):
        for _ in range(5):  # while Python starts, and while it imports
            time.sleep(0.3)
            os.kill(number, signal.SIGINT)
    return number

util.spawnv_passfds = interrupted
with _helpers(load_config(), 1, 0) as shared:
    (helper,) = shared.helpers
    assert helper.is_alive()
    helper.terminate()
"""


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="signals are not masked here")
def test_ctrl_c_while_another_process_imports_shows_no_traceback_of_it(tmp_path):
    ended = subprocess.run(
        [sys.executable, "-c", _INTERRUPTED],
        check=False,
        capture_output=True,
        text=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
    )
    assert (ended.returncode, ended.stderr) == (0, "")
