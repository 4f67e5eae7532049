"""Prometheus and Grafana ask for figures that the page has; promtool agrees where there is one."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from support.shown_service import Alarm, ShownService
from valvemap.clock import SystemClock
from valvemap.page.settings import PageSettings
from valvemap.page.web import Page

MONITORING = Path(__file__).parents[2] / "container" / "monitoring"
GUIDE = MONITORING.parents[1] / "docs" / "how-to" / "grafana.md"
BOARD = json.loads((MONITORING / "grafana" / "valvemap.json").read_text(encoding="utf-8"))
ALERTS = yaml.safe_load((MONITORING / "alerts.yml").read_text(encoding="utf-8"))
QUERIES = [
    *(target["expr"] for panel in BOARD["panels"] for target in panel["targets"]),
    *(rule["expr"] for rule in ALERTS["groups"][0]["rules"]),
]


async def figures():
    """Names of all that the page shows of a service with one valve."""
    shown = ShownService()
    shown.alarms.append(Alarm())
    page = Page(shown, lambda *_: (shown, None), PageSettings(), SystemClock())
    await page.observer.client.connect()
    await page.observer._discover()
    await page.observer._listen()
    await page.observer._look_around(page.viewers.wanted(page.observer.valves), thoroughly=True)
    page.observer.link = type(page.observer.link).UP
    await page.observer.look_at_figures()
    text = page._metrics.exposition().decode()
    return set(re.findall(r"^(valvemap_\w+)", text, re.MULTILINE))


async def test_the_guide_names_every_figure_and_no_other():
    guide = GUIDE.read_text(encoding="utf-8")
    cells = re.findall(r"^\| (`valvemap_.*?) \|", guide, re.MULTILINE)
    quantities = GUIDE.parents[1].joinpath("reference", "vocabulary.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`(valvemap_estimator_\w+)`", quantities))
    for cell in cells:
        first, *others = re.findall(r"`(\w+)`", cell)
        stem = first.removesuffix("_age_seconds")
        named |= {first, *(o if o.startswith("valvemap") else stem + o for o in others)}
    assert named == {name for name in await figures() if not name.endswith("_created")}


async def test_every_query_asks_for_figures_that_are_there():
    known = await figures()
    for query in QUERIES:
        assert set(re.findall(r"valvemap_\w+", query)) <= known, query


def test_no_two_panels_lie_on_each_other():
    taken = set()
    for panel in BOARD["panels"]:
        at = panel["gridPos"]
        cells = {(at["x"] + i, at["y"] + j) for i in range(at["w"]) for j in range(at["h"])}
        assert not cells & taken, panel["title"]
        taken |= cells


def test_promtool_takes_the_configuration_and_every_query(tmp_path):
    program = shutil.which("promtool")
    if program is None:
        pytest.skip("promtool is not installed (Debian: apt-get install prometheus)")
    rules = [{"record": f"q{k}", "expr": query} for k, query in enumerate(QUERIES)]
    file = tmp_path / "queries.yml"
    file.write_text(yaml.safe_dump({"groups": [{"name": "q", "rules": rules}]}), encoding="utf-8")
    for check in (["config", MONITORING / "prometheus.yml"], ["rules", file]):
        done = subprocess.run(
            [program, "check", *check], capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
