"""Visits of the page of a plant with an alarm, edges, a line and an axis; its views; screens."""

import time
from contextlib import asynccontextmanager

from support.browser import tab
from support.readings import Read
from support.served_page import served
from support.shown_service import Alarm, ShownService

S = 1_000_000_000
VIEWS = (
    *("valve/V1", "trend/V1", "map/V1", "alarms", "overview", "commissioning/V1", "timeline"),
    *("rig/V1", "axis/Press", "line/Boom.LineA", "valve/Boom.PA"),
)
SIZES = {"desk": (1280, 800), "large": (1920, 1080), "tablet": (820, 1180)}
RIG = "opc.tcp://127.0.0.1:1/rig/"


@asynccontextmanager
async def visit(browser, shown, **given):
    async with served(shown, RIG) as (page, url), tab(browser, url, **given) as visitor:
        await visitor.page.add_init_script("localStorage.setItem('tour', 'closed')")
        yield visitor, page


def alarmed():
    now = time.time_ns()
    frozen = Alarm(
        name="SensorFrozen",
        severity=700,
        t=now - 600 * S,
        text="p2 was constant to the last digit for 34.0 s while other signals varied (limit 10 s),"
        " since 2026-11-25 22:20:10 UTC. It may be: a dead sensor; a coarse resolution.",
    )
    shown = ShownService(
        names=("V1", "V2", "Boom.PA", "Boom.AT"),
        lines=("Boom.LineA",),
        axes=("Press",),
        more=("Commission",),
        alarms=[frozen],
        past=[frozen],
    )
    shown.values["V1.DeviceHealth"] = Read(1)
    return shown, frozen
