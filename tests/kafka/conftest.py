"""What the tests at a real Apache Kafka share."""

import pytest

from support.broker import artifacts, brokers


@pytest.fixture(scope="module")
def broker(request, tmp_path_factory):
    jars = artifacts(request.config.cache.mkdir("kafka"))
    with brokers(jars, tmp_path_factory.mktemp("kafka")) as (node,):
        yield f"127.0.0.1:{node.port}"
