"""The tables of all alarms: limits from the rules, causes and actions from the alarms' words."""

from collections.abc import Iterator

from documentation.tables import table
from valvemap.pipeline.alarm_rules import RULES
from valvemap.pipeline.alarm_states import AlarmRule
from valvemap.pipeline.alarm_words import ALARM_DESCRIPTIONS, possible_causes
from valvemap.pipeline.axis_alarms import AXIS_RULES
from valvemap.pipeline.service_alarms import FLEET_RULES, SERVICE_RULES
from valvemap.vocabulary.alarm_guide import GUIDES

BEGIN = "<!-- Made by `make reference`: tables of alarms -->"
END = "<!-- End of the tables of alarms -->"

_HEAD = """\
Every valve has {of_valve} alarms, the service {of_service}, and `valvemap fleet serve` {of_fleet}
more. An axis has {of_axis} others.
An alarm is raised when its quantity is above the limit for the delay; `Certificate` below it.
A quantity that is a number of things, or 0 or 1, has the limit 0.5, so the alarm is raised from 1.
The limit is configured in the unit of the table: `limit = 3600` of `Unexcited` is an hour."""

_NEXT = """\
The possible causes are those that `Text` names; `Changed` and `Residual` name those that the
residuals do not exclude, and also the oil or a lag."""


def alarm_tables() -> str:
    """Return the section with the number of alarms and their tables."""
    limits, actions = [], []
    for name, node, rule in _every_alarm():
        guide, delay = GUIDES[name], f"{rule.delay_s:g} s" if rule.delay_s else "none"
        limit = f"{rule.limit:,g} {guide.unit}".strip()
        limits.append(
            [node, ALARM_DESCRIPTIONS[name], guide.quantity, limit, delay, f"{rule.severity}"]
        )
        actions.append([node, "; ".join(possible_causes(name)) or "see `Text`", guide.action])
    head = _HEAD.format(
        of_valve=len(RULES),
        of_service=len(SERVICE_RULES),
        of_fleet=len(FLEET_RULES) - len(SERVICE_RULES),
        of_axis=len(AXIS_RULES),
    )
    headings = ["alarm", "meaning", "measured quantity", "default limit", "delay", "severity"]
    return "\n\n".join(
        [
            head,
            table(headings, limits),
            _NEXT,
            table(["alarm", "possible causes", "what to do"], actions),
        ]
    )


def with_alarm_tables(text: str) -> str:
    r"""Return a page with its tables of alarms replaced by the present ones.

    >>> with_alarm_tables(f"a\n{BEGIN}\nold\n{END}\nb").splitlines()[-1]
    'b'
    """
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n\n{alarm_tables()}\n\n{END}{after}"


def _every_alarm() -> Iterator[tuple[str, str, AlarmRule]]:
    """Name, node and rule of each alarm."""
    for alarm, rule in RULES.items():
        yield alarm.title, f"`{alarm.title}`", rule
    for of_service, rule in FLEET_RULES.items():
        yield of_service.label, f"`Service.Alarms.{of_service.label}`", rule
    for of_axis, rule in AXIS_RULES.items():
        yield of_axis.label, f"`{of_axis.label}`", rule
