"""The alarms of valves and service on the results server, as plain tags and as conditions.

Many clients support plain tags only; conditions follow Part 9. Both are built from the same
report, so an acknowledgement through one appears in the other.
"""

from collections.abc import Awaitable, Callable, Collection, Iterable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
from asyncua import ua

from guarded_opcua import (
    Argument,
    Clock,
    Condition,
    ConditionKey,
    Event,
    HardenedServer,
    Role,
    add_method,
    add_object,
    caller,
)
from guarded_opcua import CommandRejected as Refused
from valvemap.opcua_results.alarm_conditions import (
    CONDITION,
    add_condition,
    condition_key,
    condition_of,
    facts_of,
)
from valvemap.opcua_results.alarm_owners import AlarmOwners
from valvemap.opcua_results.answers import answered
from valvemap.opcua_results.information_model import ALARMS, SERVICE, VariableNode
from valvemap.opcua_results.result_types import ALARM, Place, type_of
from valvemap.opcua_results.result_values import Shown, alarm_values
from valvemap.opcua_results.valve_variables import alarm_variables
from valvemap.pipeline.alarm_results import AlarmChange, AlarmReport, Remark
from valvemap.pipeline.alarm_words import ALARM_DESCRIPTIONS
from valvemap.pipeline.operator_ports import Answer, Command
from valvemap.pipeline.results import Results, ValveDescription
from valvemap.vocabulary.alarm_guide import GUIDES
from valvemap.vocabulary.commands import NAMED, Action
from valvemap.vocabulary.edges import split_id

MOST_OF_A_COMMENT = 200  # characters shown in LastAction
_COMMENT = Argument("Comment", "Action taken", type=ua.VariantType.String)

Show = Callable[[str, Shown], None]
AddVariable = Callable[[ua.NodeId, VariableNode, Shown], Awaitable[Any]]


class ResultAlarms:
    """Publishes alarms and reports each change once.

    Fulfils :class:`guarded_opcua.ConditionKeeper`.

    Parameters
    ----------
    server
        The server that shows the alarms.
    valves
        The valves with alarms; the service and axes have alarms, too.
    owners
        Hold the state of the alarms and carry out acknowledgements, confirmations and comments.
    clock
        Source time of values without a sample.
    show
        Writes a variable of a valve, or of the service.
    note
        Records an action on a valve.
    stands
        Called with the reports of all alarms of a valve when one of them changed.
    keep
        Stores a change in the history; None: no history.
    """

    def __init__(
        self,
        server: HardenedServer,
        valves: Sequence[ValveDescription],
        owners: AlarmOwners,
        clock: Clock,
        show: Show,
        note: Callable[[str, str], None],
        stands: Callable[[str, Sequence[AlarmReport]], None],
        keep: Callable[[AlarmChange], None] | None = None,
    ) -> None:
        self._server = server
        self._names = [valve.name for valve in valves]
        self._valves = frozenset(self._names)
        self._owners = owners
        self._clock = clock
        self._show = show
        self._note = note
        self._stands = stands
        self._keep = keep
        self._versions = np.zeros(len(self._names), np.int64)
        self._reported: dict[tuple[str, str], int] = {}  # digest of each last report
        server.keep_conditions(self)

    def follow(
        self,
        names: Sequence[str],
        shown: Collection[str],
        keep: Callable[[AlarmChange], None] | None,
    ) -> None:
        """Switch to other valves: ``names`` by slot, and those ``shown`` now; drop the others."""
        self._names = list(names)
        self._valves = frozenset(shown)
        self._keep = keep
        self._versions = np.zeros(len(names), np.int64)
        owners = {*shown, *self._owners.axes, SERVICE}
        self._reported = {key: at for key, at in self._reported.items() if key[0] in owners}

    def publish(self, results: Results, now: int) -> None:
        """Publish the alarms of valves whose alarms changed."""
        if results.alarms is None:
            return
        valves, versions = results.valves, results.alarms.version
        changed = np.flatnonzero(versions != self._versions[valves])
        self._versions[valves] = versions
        for m in changed.tolist():
            name, reports = self._names[valves[m]], results.alarms.reports(m)
            self.take(name, reports, now)
            self._stands(name, reports)

    def take(self, owner: str, reports: Iterable[AlarmReport], now: int) -> None:
        """Publish the state of alarms that were ever active or commented; report each change."""
        came = [report for report in reports if report.at or report.commented]
        for new in alarm_values(came, now):
            self._show(owner, new)
        for report in came:
            digest = hash(facts_of(report))
            before = self._reported.get((owner, report.name))
            self._reported[owner, report.name] = digest
            condition = condition_of(self._key(owner, report.name), report)
            is_news = before is not None or condition.retain  # else it ended before the start
            if before != digest and is_news:
                self._server.conditions.report(condition)
                if self._keep is not None:
                    self._keep(AlarmChange(owner, max(report.at, report.commented), report))

    def event_of(self, owner: str, report: AlarmReport) -> Event:
        """Return the event of a change, from the alarm's report at that time; deterministic."""
        return condition_of(self._key(owner, report.name), report).event()

    async def add(self, parent: ua.NodeId, valve: str | None, add_variable: AddVariable) -> None:
        """Add the nodes of a valve's alarms, or of the service's."""
        owner = SERVICE if valve is None else valve
        reports = self._owners.alarms(valve)
        now = {new.name: new for new in alarm_values(reports, self._clock.now())}
        for alarm in reports:
            prefix = f"{owner}.{ALARMS}.{alarm.name}"
            description = f"{ALARM_DESCRIPTIONS[alarm.name]} {GUIDES[alarm.name].action}"
            each = await add_object(
                self._server,
                parent,
                prefix,
                description=description,
                type_definition=type_of(self._server, ALARM),
            )
            for node in alarm_variables(prefix):
                await add_variable(each, node, now[split_id(node.id)[1]])
            await self._add_methods(self._server, each, valve, alarm.name)
            kind = self._key(owner, alarm.name).type_definition
            folder = await add_condition(self._server, each, kind)
            self._server.add_condition(folder, partial(self._standing, valve, alarm.name))

    async def declare(self, place: Place, kind: ua.NodeId) -> None:
        """Declare the methods and the condition of an alarm, for its type."""
        await self._add_methods(place, kind, None, "")
        await add_condition(place, kind, ua.NodeId(ua.ObjectIds.AlarmConditionType))

    async def _add_methods(
        self,
        place: Place,
        parent: ua.NodeId,
        valve: str | None,
        alarm: str,
    ) -> None:
        for action in (NAMED["acknowledge"], NAMED["confirm"]):
            await add_method(
                place,
                parent,
                f"{parent.Identifier}.{action.method}",
                partial(self._act, action, valve, alarm),
                inputs=(_COMMENT,),
                required=Role.OPERATOR,
                description=action.sentence,
            )

    def keys(self, valve: str | None) -> list[ConditionKey]:
        """The conditions of a valve, or of the service."""
        owner = SERVICE if valve is None else valve
        return [self._key(owner, report.name) for report in self._owners.alarms(valve)]

    def find(self, condition: ua.NodeId) -> Condition | None:
        """Return the state of a condition; None if it does not exist."""
        found = self._owner_of(condition)
        return None if found is None else self._standing(*found)

    def retained(self) -> Iterator[Sequence[Condition]]:
        """The retained conditions, one sequence per owner."""
        for valve in (None, *self._owners.alarmed()):
            owner = SERVICE if valve is None else valve
            every = (
                condition_of(self._key(owner, report.name), report)
                for report in self._owners.alarms(valve)
            )
            yield [condition for condition in every if condition.retain]

    def acknowledge(self, condition: ua.NodeId, comment: str) -> Answer[None]:
        """Acknowledge a condition."""
        return self._act_on(condition, NAMED["acknowledge"], comment)

    def confirm(self, condition: ua.NodeId, comment: str) -> Answer[None]:
        """Confirm a condition."""
        return self._act_on(condition, NAMED["confirm"], comment)

    def remark(self, condition: ua.NodeId, comment: str) -> Answer[None]:
        """Add a comment to a condition."""
        return self._act_on(condition, NAMED["remark"], comment)

    def _act_on(self, condition: ua.NodeId, action: Action, comment: str) -> Answer[None]:
        found = self._owner_of(condition)
        if found is None:
            raise Refused(f"{condition.to_string()}: there is no such condition")
        return self._act(action, *found, comment)

    def _act(self, action: Action, valve: str | None, alarm: str, comment: str) -> Answer[None]:
        now = self._clock.now()
        remark = Remark(comment, caller(), now)
        asked = partial(self._owners.do, Command(action.name, valve, alarm, remark=remark))
        return answered(asked, lambda _: self._acted(action.method, valve, alarm, comment, now))

    def _acted(self, name: str, valve: str | None, alarm: str, comment: str, now: int) -> None:
        owner, every = SERVICE if valve is None else valve, self._owners.alarms(valve)
        self.take(owner, [report for report in every if report.name == alarm], now)
        if valve in self._owners.axes:
            return
        self._stands(owner, every)
        if valve is not None:
            self._note(valve, f"{ALARMS}.{alarm} {name} {comment[:MOST_OF_A_COMMENT]!r}")

    def _owner_of(self, condition: ua.NodeId) -> tuple[str | None, str] | None:
        """Return the valve (None: the service) and the alarm of a condition; None if unknown."""
        owner, rest = split_id(str(condition.Identifier))
        names = (owner, *rest.split("."))
        if (
            condition.NamespaceIndex != self._server.namespace_index
            or len(names) != 4
            or (names[1], names[3]) != (ALARMS, CONDITION)
            or (names[0] not in {SERVICE, *self._valves, *self._owners.axes})
        ):
            return None
        valve = None if names[0] == SERVICE else names[0]
        known = any(report.name == names[2] for report in self._owners.alarms(valve))
        return (valve, names[2]) if known else None

    def _standing(self, valve: str | None, alarm: str) -> Condition:
        (report,) = (r for r in self._owners.alarms(valve) if r.name == alarm)
        return condition_of(
            self._key(SERVICE if valve is None else valve, alarm),
            report,
        )

    def _key(self, owner: str, alarm: str) -> ConditionKey:
        return condition_key(self._server.namespace_index, owner, alarm)
