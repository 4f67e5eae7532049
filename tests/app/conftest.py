"""A rig in a process of its own, and a service in ours."""

from contextlib import contextmanager

import pytest

from guarded_opcua import ServerSettings
from support.processes import free_port, rig_url, running, wait_for
from valvemap.app.identities import APPLICATION_NAME, APPLICATION_URI
from valvemap.config.loading import load_config


@pytest.fixture
def start_rig(tmp_path):
    """Starts a rig without security on a port; the context ends it."""

    @contextmanager
    def start(port, *arguments):
        log = tmp_path / "rig.log"
        command = ["rig", "--under-demo", "--url", rig_url(port), *arguments]
        with running(*command, stdin="password\n", log=log) as process:
            wait_for(log, "opc.tcp://", process)
            yield process

    return start


@pytest.fixture
def quick_scenario(tmp_path):
    """The demo's scenario, ten times as fast."""
    file = tmp_path / "quick.toml"
    excitation = "[excitation]\nkind = 'scattered'\nhold_s = 0.02\n"
    file.write_text(f"name = 'quick'\ntime_factor = 10\n{excitation}", encoding="utf-8")
    return str(file)


@pytest.fixture
def config(tmp_path):
    """The default configuration, open, on free ports, with a state of its own."""
    loaded = load_config()
    return loaded.model_copy(
        update={
            "source": loaded.source.model_copy(
                update={"url": rig_url(free_port()), "security": "None", "startup_timeout_s": 60.0}
            ),
            "server": loaded.server.model_copy(
                update={"url": f"opc.tcp://127.0.0.1:{free_port()}/valvemap/service/"}
            ),
            "state": loaded.state.model_copy(update={"file": tmp_path / "state.sqlite"}),
        }
    )


@pytest.fixture
def open_server(config):
    """Settings of a results server without security."""
    return ServerSettings(
        url=config.server.url,
        application_uri=APPLICATION_URI,
        application_name=APPLICATION_NAME,
        namespace_uri=APPLICATION_URI,
        none_on_loopback=True,
    )
