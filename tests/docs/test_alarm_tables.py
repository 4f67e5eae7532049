"""The page of alarms has every alarm, with the limits that the code has."""

import re

import pytest

from documentation.alarms import alarm_tables
from documentation.pages import ALARMS, alarms_page
from valvemap.config.alarms import AlarmsConfig, ServiceAlarmsConfig
from valvemap.pipeline.alarm_rules import RULES
from valvemap.pipeline.alarm_words import ALARM_DESCRIPTIONS
from valvemap.pipeline.axis_alarms import AXIS_RULES
from valvemap.pipeline.service_alarms import FLEET_RULES, SERVICE_RULES
from valvemap.vocabulary.alarm_guide import GUIDES


def test_the_page_is_what_would_be_made_now():
    assert ALARMS.read_text(encoding="utf-8") == alarms_page(), "run `make reference`"


def test_every_alarm_has_guidance_and_no_guidance_lacks_its_alarm():
    assert GUIDES.keys() == ALARM_DESCRIPTIONS.keys()
    for guide in GUIDES.values():
        assert guide.action.endswith(".")
        assert not guide.quantity.endswith(".")


def test_the_tables_have_each_alarm_twice_with_the_limit_of_its_rule():
    names = {alarm.title: rule for alarm, rule in RULES.items()}
    names |= {f"Service.Alarms.{alarm.label}": rule for alarm, rule in FLEET_RULES.items()}
    names |= {alarm.label: rule for alarm, rule in AXIS_RULES.items()}
    rows = re.findall(r"^\| `([\w.]+)` \|(.+)\|$", alarm_tables(), re.MULTILINE)
    assert sorted(name for name, _ in rows) == sorted([*names, *names])
    limits = dict(rows[: len(names)])
    for name, rule in names.items():
        cells = [cell.strip() for cell in limits[name].split("|")]
        assert cells[2].split(" ")[0] == f"{rule.limit:,g}"
        assert cells[4] == str(rule.severity)


def test_the_page_counts_the_alarms():
    more = len(FLEET_RULES) - len(SERVICE_RULES)
    assert (
        f"{len(RULES)} alarms, the service {len(SERVICE_RULES)}, and `valvemap fleet serve` {more}"
        in ALARMS.read_text(encoding="utf-8")
    )


@pytest.mark.parametrize("section", [AlarmsConfig, ServiceAlarmsConfig])
def test_the_configuration_states_the_same_default_limits(section):
    rules = {alarm.title: rule for alarm, rule in RULES.items()}
    rules |= {alarm.label: rule for alarm, rule in SERVICE_RULES.items()}
    for name, found in section.model_fields.items():
        stated = re.search(r"default ([\d.,]*\d)", found.description)
        assert stated, name
        assert float(stated[1].replace(",", "")) == rules[name].limit, name
