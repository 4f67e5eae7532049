"""What is given to people to import names what is there."""

import json
import re

import pytest_asyncio

from documentation.address_space import nodes
from support import fuxa, node_red
from valvemap.config.models import Config
from valvemap.opcua_results.result_types import ENUMERATIONS

VARIABLE = re.compile(r"\b(?:Signals|Inverse|Auto|RLS)\.[A-Za-z0-9.]+")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def there():
    """The nodes of a demo, by what foreign programs call them."""
    return {f"ns=1;s={found.id}": found for found in await nodes(Config())}


def test_the_flow_names_only_nodes_that_a_demo_has(there):
    named = set(VARIABLE.findall(node_red.FLOW.read_text(encoding="utf-8")))
    assert len(named) >= 15
    assert {f"ns=1;s=Valvistor.{name}" for name in named} <= set(there)


def test_the_project_names_only_nodes_that_a_demo_has_and_their_types(there):
    enumerations = {f"`{kind.__name__}`" for kind in ENUMERATIONS}  # encoded as Int32
    for tag in fuxa.project_tags().values():
        kind = there[tag["address"]].kind
        assert ("`Int32`" if kind in enumerations else kind) == f"`{tag['type']}`"


def test_what_the_project_shows_are_tags_of_its_own():
    project = json.loads(fuxa.PROJECT.read_text(encoding="utf-8"))
    (view,) = project["hmi"]["views"]
    shown = [item["property"].get("variableId") for item in view["items"].values()]
    drawn = [line["id"] for chart in project["charts"] for line in chart["lines"]]
    watched = [alarm["property"]["variableId"] for alarm in project["alarms"]]
    assert {*filter(None, shown), *drawn, *watched} <= set(fuxa.project_tags())
    charts = {item["property"]["id"] for item in view["items"].values() if "id" in item["property"]}
    assert {chart["id"] for chart in project["charts"]} <= charts
