"""What the tests of SCADA programs share: a demo, and a service that lets users in alone."""

import pytest

from support import services


@pytest.fixture(scope="session")
def demo(tmp_path_factory):
    with services.demo(tmp_path_factory.mktemp("demo")) as service:
        yield service


@pytest.fixture(scope="session")
def installation(tmp_path_factory):
    with services.installation(tmp_path_factory.mktemp("installation")) as service:
        yield service
