"""What the page sees of a service that changes while it looks."""

import pytest

from support.readings import Read
from support.shown_service import ShownService
from valvemap.clock import SystemClock
from valvemap.errors import SourceLost
from valvemap.page.settings import PageSettings
from valvemap.page.web import Page


async def test_valves_that_came_or_went_are_looked_for_anew():
    service = ShownService()
    page = Page(service, lambda *_: (service, None), PageSettings(), SystemClock())
    observer = page.observer
    await observer.client.connect()
    await observer._discover()
    wanted = page.viewers.wanted(observer.places)
    await observer._look_around(wanted, thoroughly=True)
    service.names = ("V1", "V2")
    service.values["Identification.NodeVersion"] = Read("another one")
    with pytest.raises(SourceLost, match="added or removed"):
        await observer._look_around(wanted, thoroughly=True)
    await observer._discover()
    assert [valve.name for valve in observer.valves] == ["V1", "V2"]
    await observer._look_around(page.viewers.wanted(observer.places), thoroughly=True)
