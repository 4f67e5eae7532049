"""Prometheus and Grafana ask for figures that the page has; promtool agrees where there is one."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from support.exposition import names, promtool_accepts
from support.shown_service import Alarm, ShownService
from valvemap.clock import SystemClock
from valvemap.page.settings import PageSettings
from valvemap.page.web import Page
from valvemap.vocabulary.program_series import PROGRAMS
from valvemap.vocabulary.series import COMPILED, OF_PAGE

MONITORING = Path(__file__).parents[2] / "container" / "monitoring"
BOARDS = {
    name: json.loads((MONITORING / "grafana" / f"{name}.json").read_text(encoding="utf-8"))
    for name in ("valvemap", "fleet")
}
PANELS = [panel for board in BOARDS.values() for panel in board["panels"]]
ALERTS = yaml.safe_load((MONITORING / "alerts.yml").read_text(encoding="utf-8"))
DRAWN = [target["expr"] for panel in PANELS for target in panel["targets"]]
ALARMED = [rule["expr"] for rule in ALERTS["groups"][0]["rules"]]
QUERIES = [*DRAWN, *ALARMED]
SERIES = {one.shown: one for of in PROGRAMS.values() for one in of}
OF_MANY = {
    "valve",
    "estimator",
    "source",
    "alarm",
    "partition",
    "group",
}  # labels with 1,000 values
FEW = {"what": "Gaps", "state": "disconnected"}  # a value of other labels that queries ask for
MOST_LINES = 20


async def page_text():
    """All metrics of a page of a service with one valve, one axis and one alarm."""
    shown = ShownService(axes=("Press",))
    shown.alarms.append(Alarm())
    page = Page(shown, lambda *_: (shown, None), PageSettings(), SystemClock())
    await page.observer.client.connect()
    await page.observer._discover()
    await page.observer._listen()
    await page.observer._look_around(page.viewers.wanted(page.observer.places), thoroughly=True)
    page.observer.link = type(page.observer.link).UP
    await page.observer.look_at_figures()
    return page._metrics.exposition().decode()


async def test_the_page_has_every_series_of_its_table_and_promtool_accepts_them():
    text = await page_text()
    at_the_start = {COMPILED.shown}
    assert names(text) == {one.shown for one in OF_PAGE} - at_the_start
    promtool_accepts(text)


def test_every_query_asks_for_series_that_a_program_has_by_labels_that_they_have():
    for query in QUERIES:
        asked = re.findall(r"(valvemap_\w+)(?:\{([^}]*)\})?", query)
        assert asked, query
        for name, selectors in asked:
            labels = set(re.findall(r"(\w+)(?:=~|!~|!=|=)", selectors)) - {"job"}
            assert labels <= set(SERIES[name].labels), query


@pytest.mark.parametrize("query", DRAWN)
def test_no_panel_draws_a_line_for_each_of_a_thousand_valves(query):
    """By valve, alarm or partition only the largest; else a sum, or one line a program."""
    many = {
        label
        for name in re.findall(r"valvemap_\w+", query)
        for label in SERIES[name].labels
        if label in OF_MANY
    }
    if not many:
        return
    largest = re.search(r"\b(?:topk|bottomk)\((\d+),", query)
    if largest:
        assert int(largest[1]) <= MOST_LINES
    else:
        kept = re.search(r"\b(?:sum|max|count)(?: by \(([^)]*)\))?", query)
        assert kept, query
        assert not set(re.split(r"[, ]+", kept[1] or "")) & OF_MANY, query


def test_a_panel_of_several_queries_draws_no_more_lines_either():
    for panel in PANELS:
        largest = [
            int(number)
            for target in panel["targets"]
            for number in re.findall(r"\b(?:topk|bottomk)\((\d+),", target["expr"])
        ]
        assert sum(largest) <= MOST_LINES, panel["title"]


@pytest.mark.parametrize("board", BOARDS.values(), ids=BOARDS)
def test_data_source_and_valves_are_chosen_above_the_panels(board):
    variables = {one["name"]: one["type"] for one in board["templating"]["list"]}
    assert variables["source"] == "datasource"
    assert variables["valve"] == "query"
    assert {panel["datasource"]["uid"] for panel in board["panels"]} == {"${source}"}


@pytest.mark.parametrize("board", BOARDS.values(), ids=BOARDS)
def test_no_two_panels_lie_on_each_other(board):
    taken = set()
    for panel in board["panels"]:
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


def thousand(name):
    """A thousand series of a name, as promtool's tests take them: each alike over ten minutes."""
    labels = SERIES[name].labels
    growth = 1 if SERIES[name].is_count else 0
    for k in range(1_000 if OF_MANY & set(labels) else 1):
        kept = {
            label: f"{label}{k}" if label in OF_MANY else FEW.get(label, "x") for label in labels
        }
        chosen = ",".join(f'{label}="{text}"' for label, text in {"job": "j", **kept}.items())
        yield {"series": f"{name}{{{chosen}}}", "values": f"{k}+{growth * (k + 1)}x10"}


def test_promtool_draws_no_more_lines_of_a_thousand_series(tmp_path):
    program = shutil.which("promtool")
    if program is None:
        pytest.skip("promtool is not installed (Debian: apt-get install prometheus)")
    asked = {name for query in DRAWN for name in re.findall(r"valvemap_\w+", query)}
    lines = [
        re.sub(r"\$(valve|job)", ".*", f"count({query}) <= bool {MOST_LINES}") for query in DRAWN
    ]
    one = {"labels": "{}", "value": 1}
    tests = {
        "interval": "1m",
        "input_series": [series for name in sorted(asked) for series in thousand(name)],
        "promql_expr_test": [
            {"expr": expr, "eval_time": "10m", "exp_samples": [one]} for expr in lines
        ],
    }
    file = tmp_path / "tests.yml"
    content = {"rule_files": [], "evaluation_interval": "1m", "tests": [tests]}
    file.write_text(json.dumps(content), encoding="utf-8")
    done = subprocess.run(
        [program, "test", "rules", file], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[:3_000]
