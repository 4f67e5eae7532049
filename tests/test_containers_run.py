"""The containers of docker-compose.yml run, with the rig and with a server of another make."""

import asyncio
import json
import re
import ssl
import subprocess
import time
import urllib.request

import pytest
from asyncua import ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256

from guarded_opcua import Pki, ensure_certificate
from support import compose
from support.base_image import base_image
from support.compose import ROOT, Project
from support.processes import free_port
from support.served import patient
from valvemap.opcua_results.namespaces import SERVICE_NAMESPACE

pytestmark = [pytest.mark.image, pytest.mark.soak, pytest.mark.timeout(3600)]

PLC = "from foreign import *; Foreign(PLANT, ['Ventil 7'], listen='0.0.0.0:4840').run()"
OWN = {"SOURCE_URL": "opc.tcp://plc:4840"}
COMMANDS = re.search(
    r"## As containers\n(.*?)\n## ", (ROOT / "docs" / "own_server.md").read_text(), re.DOTALL
)[1]


@pytest.fixture(scope="module")
def project():
    if why := compose.missing():
        pytest.skip(why)
    published = re.search(
        r"^ARG PYTHON_IMAGE=(.+)$", (ROOT / "Dockerfile").read_text(), re.MULTILINE
    )[1]
    base, tag = base_image(published, "buildah"), "localhost/valvemap-test"
    words = "--isolation=chroot", "--layers", "--format=docker", f"--tag={tag}"
    build = ["buildah", "build", *words, f"--build-arg=PYTHON_IMAGE={base}", ROOT]
    done = subprocess.run(build, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    with Project("valvemaptest", tag) as project:
        try:
            project.run("init", "--help")
        except AssertionError as error:
            pytest.skip(f"podman runs no containers here: {error}")
        yield project


@pytest.fixture(scope="module")
def ports():
    return {
        "VALVEMAP_RIG_PORT": str(free_port()),
        "VALVEMAP_SERVICE_PORT": str(free_port()),
        "VALVEMAP_PAGE_PORT": str(free_port()),
    }


@pytest.fixture(scope="module")
def password(project):
    """The operator's, which the first run of `init` prints."""
    done = project.run("init")
    assert done.returncode == 0, done.stderr
    return re.search(r"user operator, password (\S+)", done.stdout)[1]


def test_the_rig_the_service_and_its_page_run_locked_down(project, ports, password):
    idle = project.run("connect")
    assert (idle.returncode, idle.stdout) == (0, "")
    for service in ("rig", "service", "page"):
        project.start(service, **ports)
        project.wait_healthy(service)
    assert samples(ports, 'valve="Valvistor"') > 0
    for service in ("page", "service", "rig"):
        assert "Traceback" not in project.log(service)


def test_with_source_url_a_client_reads_the_results_of_another_server(
    project, ports, password, tmp_path
):
    for line in ("docker compose run --rm connect", "init trust THUMBPRINT", "docker compose up"):
        assert line in COMMANDS
    project.start_foreign("plc", PLC, ROOT / "tests" / "support")
    written = project.run("connect", **OWN)
    assert written.returncode == 0, written.stdout + written.stderr
    again = project.run("connect", **OWN)
    assert (again.returncode, again.stdout) == (0, "")
    project.start("service", **ports, **OWN)
    project.wait_healthy("service")
    project.start("page", **ports)
    project.wait_healthy("page")
    assert samples(ports, 'valve="Ventil_7"') > 0
    assert asyncio.run(read_as_operator(project, ports, password, tmp_path)) > 0


def test_an_operator_logs_in_on_the_page_by_https(project, ports, password, tmp_path):
    openssl = re.search(r"^openssl .*?(?<!\\)$", COMMANDS, re.MULTILINE | re.DOTALL)[0]
    subprocess.run(["sh", "-c", openssl], cwd=tmp_path, check=True, capture_output=True)
    pem = (tmp_path / "page.pem").read_text() + (tmp_path / "page.crt").read_text()
    assert "cat page.crt >> page.pem" in COMMANDS
    kept = project.run("init", "-c", "umask 77; cat > /data/page.pem", entrypoint="sh", stdin=pem)
    assert kept.returncode == 0, kept.stderr
    https = {"VALVEMAP_PAGE_HTTPS": "yes"}
    project.start("page", **ports, **https)
    project.wait_healthy("page", **https)
    trusted = ssl.create_default_context(cafile=tmp_path / "page.crt")
    url = f"https://localhost:{ports['VALVEMAP_PAGE_PORT']}"
    body = json.dumps({"user": "operator", "password": password}).encode()
    head = {"Content-Type": "application/json", "Origin": url}
    asked = urllib.request.Request(f"{url}/log-in", body, head)  # noqa: S310 - our own page
    with urllib.request.urlopen(asked, timeout=60, context=trusted) as answer:  # noqa: S310
        assert json.load(answer) == {"user": "operator"}


def samples(ports, label):
    """How many samples a valve has learnt from, once there are some."""
    url = f"http://localhost:{ports['VALVEMAP_PAGE_PORT']}/metrics"
    found, end = None, time.monotonic() + 120.0
    while found is None and time.monotonic() < end:
        with urllib.request.urlopen(url, timeout=10) as answer:
            text = answer.read().decode()
        found = re.search(rf"^valvemap_samples_total{{{label}}} ([1-9].*)$", text, re.MULTILINE)
        time.sleep(0.5)
    assert found is not None, text
    return float(found[1])


async def read_as_operator(project, ports, password, pki):
    """Number of samples that a client on the host reads, once the service trusts it."""
    own = ensure_certificate(Pki(pki), "urn:test:client", ("localhost",), "client")
    client = patient(f"opc.tcp://127.0.0.1:{ports['VALVEMAP_SERVICE_PORT']}/valvemap/service/")
    client.application_uri = "urn:test:client"
    client.set_user("operator")
    client.set_password(password)
    await client.set_security(SecurityPolicyBasic256Sha256, str(own.certificate), str(own.key))
    with pytest.raises((ua.UaError, OSError, asyncio.TimeoutError)):
        await client.connect()
    (rejected,) = project.execute("service", "valvemap", "trust").stdout.splitlines()
    assert project.execute("service", "valvemap", "trust", rejected.split()[0]).returncode == 0
    async with client:
        index = await client.get_namespace_index(SERVICE_NAMESPACE)
        return await client.get_node(ua.NodeId("Ventil_7.RLS.SampleCount", index)).read_value()
