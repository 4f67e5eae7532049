"""Only who is logged in acts, with the rights of that user; everybody else looks."""

import httpx

from support.shown_service import ShownService
from valvemap.clock import ManualClock
from valvemap.errors import SourceRejected
from valvemap.page.settings import PageSettings
from valvemap.page.web import Page

OWN = "http://127.0.0.1:8080"


class Plant:
    """Makes clients; keeps those that it made."""

    def __init__(self):
        self.made = []

    def clients(self, user, password):
        service, rig = ShownService(), ShownService()
        if password != "right":
            service.connect = self._refuse
        self.made.append((user, service, rig))
        return service, rig

    async def _refuse(self):
        raise SourceRejected("user or password are wrong")


class Visit:
    """A browser on a page with that plant behind it."""

    def __init__(self, **settings):
        self.plant, self.clock = Plant(), ManualClock()
        own = PageSettings(**settings)
        self.page = Page(ShownService(), self.plant.clients, own, self.clock, "opc.tcp://rig:1/")
        transport = httpx.ASGITransport(app=self.page.guard)
        self.browser = httpx.AsyncClient(transport=transport, base_url=OWN)

    async def post(self, path, **body):
        return await self.browser.post(path, json=body, headers={"Origin": OWN})

    async def log_in(self, password="right"):  # noqa: S107
        return await self.post("/log-in", user="operator", password=password)


async def test_a_stranger_writes_nothing():
    visit = Visit()
    answer = await visit.post("/command", demand="V1", Q=60, dp=100)
    assert answer.status_code == 401
    assert visit.plant.made == []


async def test_a_user_s_demand_is_written_in_the_user_s_own_connection():
    visit = Visit()
    await visit.log_in()
    assert (await visit.post("/command", demand="V1", Q=60, dp=100.5)).status_code == 200
    ((user, service, _),) = visit.plant.made
    assert user == "operator"
    assert service.writes == [("V1.Inverse.PressureDrop", 100.5), ("V1.Inverse.FlowDemand", 60.0)]


async def test_the_rig_is_played_with_as_the_user():
    visit = Visit()
    await visit.log_in()
    await visit.post("/command", scenario="cycle")
    await visit.post("/command", fault="damage", valve="V1", size=-10, duration=0)
    ((_, _, rig),) = visit.plant.made
    assert rig.calls == [
        ("Rig", "StartScenario", (("cycle",),)),
        ("V1", "InjectFault", (("damage", -10.0, 0.0),)),
    ]


async def test_the_cookie_is_no_script_s_and_no_other_site_s_business():
    cookie = (await Visit().log_in()).headers["set-cookie"]
    assert "HttpOnly" in cookie
    assert "samesite=strict" in cookie.lower()


async def test_wrong_passwords_are_said_and_stop_before_the_service_locks_the_user_out():
    visit = Visit()
    answers = [await visit.log_in("wrong") for _ in range(6)]
    assert "wrong" in answers[0].json()["error"]
    assert "wait" in answers[-1].json()["error"]
    assert len(visit.plant.made) == 3 == visit.page.log_ins.failed
    assert all(service.closed for _, service, _ in visit.plant.made)
    assert (await visit.log_in()).status_code == 403
    other = await visit.post("/log-in", user="anna", password="right")
    assert other.status_code == 200
    visit.clock.advance(306.0)
    assert (await visit.log_in()).status_code == 200


async def test_a_flood_of_names_is_slowed_down():
    visit = Visit()
    for number in range(30):
        await visit.post("/log-in", user=f"user{number}", password="wrong")
    assert len(visit.plant.made) == 10


async def test_a_made_up_cookie_is_nobody():
    visit = Visit()
    await visit.log_in()
    visit.browser.cookies.clear()
    visit.browser.cookies.set("valvemap", "x" * 43, domain="127.0.0.1")
    assert (await visit.post("/command", demand="V1", Q=1, dp=1)).status_code == 401


async def test_who_logs_out_or_does_nothing_for_long_is_forgotten():
    visit = Visit()
    await visit.log_in()
    await visit.post("/log-out")
    assert len(visit.page.log_ins) == 0
    await visit.log_in()
    visit.clock.advance(901.0)
    await visit.page.log_ins.forget_unused()
    assert len(visit.page.log_ins) == 0
    assert all(service.closed for _, service, _ in visit.plant.made)


async def test_commands_that_make_no_sense_do_nothing():
    visit = Visit()
    await visit.log_in()
    for body in (
        {"demand": "V1"},
        {"demand": "V1", "Q": "60", "dp": 1},
        {"demand": "", "Q": 60, "dp": 1},
        {"fault": "damage\n", "valve": "V1", "size": 1, "duration": 0},
        {"write": "V1.RLS.Status", "value": 1},
    ):
        assert (await visit.post("/command", **body)).status_code == 409
    ((_, service, rig),) = visit.plant.made
    assert (service.writes, service.calls, rig.calls) == ([], [], [])
