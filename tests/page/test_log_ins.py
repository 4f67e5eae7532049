"""Only who is logged in acts, with the rights of that user; everybody else looks."""

import asyncio

import httpx

from support.shown_service import ShownService
from valvemap.clock import ManualClock
from valvemap.errors import SourceLost, SourceRejected
from valvemap.page.settings import PageSettings
from valvemap.page.web import Page

OWN = "http://127.0.0.1:8080"


class Plant:
    """Makes clients; keeps those that it made."""

    def __init__(self):
        self.made = []
        self.addresses = []

    def clients(self, user, password, address):
        self.addresses.append(address)
        service, rig = ShownService(), ShownService()
        if password == "away":
            service.up = False
        elif password != "right":
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
        self.browser = self.browser_at("10.0.0.1")

    def browser_at(self, address):
        transport = httpx.ASGITransport(app=self.page.guard, client=(address, 50_000))
        return httpx.AsyncClient(transport=transport, base_url=OWN)

    async def post(self, path, **body):
        return await self.browser.post(path, json=body, headers={"Origin": OWN})

    async def log_in(self, password="right", address=None, user="operator"):  # noqa: S107
        browser = self.browser if address is None else self.browser_at(address)
        body = {"user": user, "password": password}
        return await browser.post("/log-in", json=body, headers={"Origin": OWN})


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


async def test_a_service_that_does_not_answer_is_no_wrong_password():
    visit = Visit()
    answers = [await visit.log_in("away") for _ in range(5)]
    assert {answer.status_code for answer in answers} == {503}
    assert "does not answer: try again" in answers[-1].json()["error"]
    assert (await visit.log_in()).status_code == 200


async def test_wrong_passwords_lock_the_address_they_come_from_and_no_other():
    visit = Visit()
    for address in ("10.0.0.2", "10.0.0.3", "10.0.0.4"):
        answers = [await visit.log_in("wrong", address) for _ in range(5)]
        assert "wait" in answers[-1].json()["error"]
    assert (await visit.log_in("right", "10.0.0.2")).status_code == 403
    assert (await visit.log_in("right", "10.0.0.9")).status_code == 200


async def test_an_ipv6_network_guesses_as_one_address():
    visit = Visit()
    for number in range(1, 9):
        await visit.log_in("wrong", f"2001:db8::{number}")
    assert len(visit.plant.made) == 3
    assert (await visit.log_in("right", "2001:db8:0:1::1")).status_code == 200


async def test_guesses_from_many_addresses_lock_out_strangers_and_no_known_address():
    visit = Visit()
    await visit.log_in("right", "10.0.0.9")
    for number in range(20):
        for _ in range(3):
            await visit.log_in("wrong", f"10.0.1.{number}")
    assert visit.page.log_ins.failed == 30
    assert (await visit.log_in("right", "10.0.2.1")).status_code == 403
    assert (await visit.log_in("right", "10.0.0.9")).status_code == 200
    visit.clock.advance(306.0)
    assert (await visit.log_in("right", "10.0.2.1")).status_code == 200


async def test_a_service_that_is_away_is_no_wrong_password():
    visit = Visit()

    async def gone():
        raise SourceLost("gone")

    visit.plant._refuse = gone
    for _ in range(5):
        assert "gone" in (await visit.log_in("wrong")).json()["error"]
    assert (await visit.log_in()).status_code == 200


async def test_the_service_hears_from_where_a_user_logs_in():
    visit = Visit()
    await visit.log_in("right", "::ffff:10.0.0.7")
    assert visit.plant.addresses == ["10.0.0.7"]


async def test_who_logs_in_often_loses_own_log_ins_and_nobody_else_s():
    visit = Visit()
    await visit.log_in(user="anna")
    for _ in range(9):
        visit.clock.advance(10.0)
        assert (await visit.log_in()).status_code == 200
    assert [user for user, service, _ in visit.plant.made if not service.closed] == [
        *("anna", *4 * ("operator",))
    ]
    assert len(visit.page.log_ins) == 5


async def test_a_flood_of_names_from_elsewhere_holds_up_no_operator():
    visit = Visit()
    await visit.log_in()
    flood = [visit.log_in("wrong", "10.0.0.2", f"user{n}") for n in range(50)]
    answers = asyncio.gather(*flood)
    assert (await visit.log_in()).status_code == 200
    await answers
    assert (await visit.log_in(address="10.0.0.3")).status_code == 200


async def test_a_flood_of_names_is_slowed_down():
    visit = Visit()
    for number in range(30):
        await visit.post("/log-in", user=f"user{number}", password="wrong")
    assert len(visit.plant.made) == 10


async def test_a_name_that_no_user_can_have_is_not_tried():
    visit = Visit()
    answer = await visit.log_in(user="x" * 65)
    assert (answer.status_code, visit.plant.made) == (403, [])
    assert visit.page.log_ins.refused == 1


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


async def test_an_alarm_is_acknowledged_confirmed_and_commented_on_as_the_user():
    visit = Visit()
    await visit.log_in()
    alarm = {"alarm": "Changed", "of": "V1", "comment": "seen"}
    for step in ("Acknowledge", "Confirm"):
        assert (await visit.post("/command", **alarm, do=step)).status_code == 200
    assert (await visit.post("/command", **alarm, do="Comment", event="0aff")).status_code == 200
    ((_, service, _),) = visit.plant.made
    assert service.calls == [
        ("V1.Alarms.Changed", "Acknowledge", (("seen",),)),
        ("V1.Alarms.Changed", "Confirm", (("seen",),)),
    ]
    assert service.comments == [("V1.Alarms.Changed.Condition", b"\x0a\xff", "seen")]


async def test_a_guided_run_is_started_kept_alive_and_aborted_as_the_user():
    visit = Visit()
    await visit.log_in()
    for command in (
        {"do": "Start", "accuracy": 0.5},
        {"do": "Heartbeat", "count": 7},
        {"do": "Abort"},
    ):
        assert (await visit.post("/command", run="V1", **command)).status_code == 200
    assert (await visit.post("/command", run="V1", do="Start")).status_code == 409
    ((_, service, _),) = visit.plant.made
    assert service.calls == [
        ("V1.Commission", "Start", ((0.5,),)),
        ("V1.Commission", "Abort", ((),)),
    ]
    assert service.writes == [("V1.Commission.Heartbeat", 7.0)]


async def test_a_map_is_approved_or_rolled_back_as_the_user():
    visit = Visit()
    await visit.log_in()
    for step in ("Approve", "RollBack"):
        assert (await visit.post("/command", baseline="V1", do=step)).status_code == 200
    ((_, service, _),) = visit.plant.made
    assert service.calls == [("V1.Baseline", "Approve", ((),)), ("V1.Baseline", "RollBack", ((),))]


async def test_no_other_method_is_called_by_an_alarm_or_a_map():
    visit = Visit()
    await visit.log_in()
    alarm = {"alarm": "Changed", "of": "V1", "comment": ""}
    for body in (
        alarm | {"do": "Reset"},
        alarm | {"do": "Acknowledge", "comment": "x" * 201},
        alarm | {"do": "Acknowledge", "comment": "two\nlines"},
        alarm | {"do": "Comment", "event": "not hexadecimal"},
        {"baseline": "V1", "do": "ValveReplaced"},
    ):
        assert (await visit.post("/command", **body)).status_code == 409
    ((_, service, _),) = visit.plant.made
    assert (service.calls, service.comments) == ([], [])
