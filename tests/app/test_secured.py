"""Rig and service as one installs them: init, certificates, users; no door is open."""

import asyncio

import pytest
from asyncua import Client, ua
from asyncua.crypto.security_policies import (
    SecurityPolicyAes256Sha256RsaPss,
    SecurityPolicyBasic256Sha256,
)

from guarded_opcua import Pki, ensure_certificate
from support.processes import free_port, run, service_url
from support.served import patient
from support.services import PASSWORD, installation

pytestmark = pytest.mark.waits

POLICIES = [SecurityPolicyBasic256Sha256, SecurityPolicyAes256Sha256RsaPss]
CLIENT_URI = "urn:test:client"


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    with installation(tmp_path_factory.mktemp("plant")) as service:
        yield service


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """A client's certificate that the service learns to trust the way a person teaches it."""
    pki = Pki(tmp_path_factory.mktemp("client"))
    return ensure_certificate(pki, CLIENT_URI, ("localhost",), "client")


async def connected(plant, own, policy=SecurityPolicyBasic256Sha256, user="operator"):
    client = patient(plant.url)
    client.application_uri = CLIENT_URI
    if user:
        client.set_user(user)
        client.set_password(PASSWORD)
    await client.set_security(policy, str(own.certificate), str(own.key))
    return client


async def test_an_unknown_client_is_refused_until_it_is_trusted(plant, own):
    client = await connected(plant, own)
    with pytest.raises((ua.UaError, OSError, asyncio.TimeoutError)):
        async with client:
            pass
    (rejected,) = run("trust", env=plant.env).stdout.splitlines()
    mark, subject = rejected.split(maxsplit=1)
    assert "CN=" in subject
    assert run("trust", mark, env=plant.env).returncode == 0
    trusted = run("trust", str(own.certificate), env=plant.env)
    assert trusted.returncode == 0, trusted.stderr


@pytest.mark.parametrize("policy", POLICIES, ids=lambda policy: policy.__name__)
async def test_a_trusted_client_reads_results_under_either_policy(plant, own, policy):
    run("trust", str(own.certificate), env=plant.env)
    async with await connected(plant, own, policy) as client:
        index = await client.get_namespace_index("urn:valvemap:service")
        node = client.get_node(ua.NodeId("Valvistor.RLS.ParameterVector", index))
        async with asyncio.timeout(20):
            while True:
                data = await node.read_data_value(raise_on_bad_status=False)
                if data.StatusCode.is_good():
                    break
                await asyncio.sleep(0.1)
        assert len(data.Value.Value) == 5


async def test_nobody_gets_in_without_security_or_without_a_name(plant, own):
    run("trust", str(own.certificate), env=plant.env)
    for url in (plant.rig, plant.url):
        with pytest.raises((ua.UaError, OSError, asyncio.TimeoutError)):
            async with Client(url, timeout=2):
                pass
    nameless = await connected(plant, own, user="")
    with pytest.raises((ua.UaError, OSError, asyncio.TimeoutError)):
        async with nameless:
            pass


async def test_only_sealed_endpoints_are_offered(plant):
    for url in (plant.rig, plant.url):
        endpoints = await patient(url).connect_and_get_server_endpoints()
        modes = {endpoint.SecurityMode for endpoint in endpoints}
        assert modes == {ua.MessageSecurityMode.SignAndEncrypt}
        assert len(endpoints) == 2


def test_a_second_init_keeps_what_is_there(plant):
    before = (plant.data / "users.json").read_bytes()
    assert run("init", env=plant.env).returncode == 0
    assert (plant.data / "users.json").read_bytes() == before


def test_a_service_that_the_rig_does_not_trust_says_so(plant, tmp_path):
    env = {**plant.env, "VALVEMAP_SECURITY__PKI": str(tmp_path / "pki")}
    env |= {
        "VALVEMAP_SERVER__URL": service_url(free_port()),
        "VALVEMAP_STATE__FILE": str(tmp_path / "state.sqlite"),
        "VALVEMAP_SOURCE__STARTUP_TIMEOUT_S": "3",
    }
    answer = run("serve", "--config", str(plant.data / "service.toml"), env=env)
    assert answer.returncode == 1
    last = answer.stderr.strip().splitlines()[-1]
    assert last.startswith("valvemap: ")
    assert "certificate" in last
    assert "Traceback" not in answer.stderr
