"""Visitors that are not ours: refused, counted, nobody disturbed."""

import httpx
import pytest

from support.shown_service import ShownService
from valvemap.clock import SystemClock
from valvemap.errors import ConfigurationError
from valvemap.page.settings import PageSettings
from valvemap.page.web import STATIC, Page

OWN = "http://127.0.0.1:8080"


def page(**settings):
    return Page(
        ShownService(), lambda *_: (ShownService(), None), PageSettings(**settings), SystemClock()
    )


def browser(page, base=OWN, address="127.0.0.1"):
    transport = httpx.ASGITransport(app=page.guard, client=(address, 50_000))
    return httpx.AsyncClient(transport=transport, base_url=base)


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example:8080", "", "10.0.0.1"])
async def test_a_foreign_name_for_this_address_gets_nothing(host):
    served = page()
    async with browser(served) as visitor:
        answer = await visitor.get("/", headers={"Host": host})
    assert (answer.status_code, served.guard.refusals["host"]) == (421, 1)


async def test_a_configured_name_is_let_in():
    async with browser(page(host_names=("plant.example",)), "http://plant.example:8080") as visitor:
        assert (await visitor.get("/livez")).status_code == 200


@pytest.mark.parametrize(
    "origin", [None, "http://evil.example", "https://127.0.0.1:8080", "http://127.0.0.1:9", "null"]
)
async def test_what_acts_must_come_from_the_page_itself(origin):
    served = page()
    async with browser(served) as visitor:
        headers = {} if origin is None else {"Origin": origin}
        answer = await visitor.post("/log-in", json={"user": "a", "password": "b"}, headers=headers)
    assert (answer.status_code, served.guard.refusals["origin"]) == (403, 1)


async def test_a_large_or_endless_request_is_not_read():
    served = page()

    async def endless():
        yield b"x" * 10_000

    async with browser(served) as visitor:
        large = await visitor.post("/log-in", content=b"x" * 5_000, headers={"Origin": OWN})
        unbounded = await visitor.post("/log-in", content=endless(), headers={"Origin": OWN})
    assert (large.status_code, unbounded.status_code) == (413, 413)
    assert served.guard.refusals["size"] == 2


async def test_a_flood_of_one_address_is_slowed_down_and_others_are_not():
    served = page(requests_per_s=0.001, request_burst=10.0)
    async with browser(served, address="10.0.0.9") as flood, browser(served) as other:
        codes = [(await flood.get("/livez")).status_code for _ in range(15)]
        assert (await other.get("/livez")).status_code == 200
    assert codes == [200] * 10 + [429] * 5


async def test_every_answer_forbids_scripts_frames_and_requests_elsewhere():
    async with browser(page()) as visitor:
        for path in ("/", "/js/main.js", "/livez", "/nothing"):
            headers = (await visitor.get(path)).headers
            policy = headers["content-security-policy"]
            assert "default-src 'none'" in policy
            assert "script-src 'self';" in policy
            assert "frame-ancestors 'none'" in policy
            assert headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize("path", ["/../settings.py", "/%2e%2e/settings.py", "/js/..%2f..%2fweb.py"])
async def test_no_path_leaves_the_page_s_files(path):
    async with browser(page()) as visitor:
        assert (await visitor.get(path)).status_code == 404


async def test_a_file_comes_whole_and_once_as_long_as_it_stays_the_same():
    for path in ("/js/main.js", "/vendor/plotly/plotly-gl3d.min.js", "/"):
        file = STATIC / (path.lstrip("/") or "index.html")
        async with browser(page()) as visitor:
            first = await visitor.get(path)
            assert (first.content, len(file.read_bytes())) == (
                file.read_bytes(),
                int(first.headers["content-length"]),
            )
            headers = {"If-None-Match": first.headers["etag"]}
            assert (await visitor.get(path, headers=headers)).status_code == 304
            assert (await visitor.head(path)).headers["etag"] == first.headers["etag"]


async def test_garbage_where_a_log_in_is_expected_is_an_answer_not_a_fault():
    async with browser(page()) as visitor:
        for body in (b"", b"[]", b"{", b"[" * 2_000, b'{"user": 1}', b"\xff\xfe", b"null"):
            answer = await visitor.post("/log-in", content=body, headers={"Origin": OWN})
            assert answer.status_code == 400
            answer = await visitor.post("/command", content=body, headers={"Origin": OWN})
            assert answer.status_code == 401


async def test_off_loopback_nobody_logs_in_without_https():
    async with browser(page(host="0.0.0.0", host_names=("plant",)), "http://plant:8080") as visitor:  # noqa: S104
        assert (await visitor.get("/user")).json()["mayLogIn"] is False
        body = {"user": "operator", "password": "secret"}
        answer = await visitor.post("/log-in", json=body, headers={"Origin": "http://plant:8080"})
    assert answer.status_code == 403


def test_a_certificate_without_its_key_is_refused(tmp_path):
    file = tmp_path / "page.pem"
    file.touch()
    with pytest.raises(ConfigurationError, match="--key"):
        PageSettings(certificate=file)
