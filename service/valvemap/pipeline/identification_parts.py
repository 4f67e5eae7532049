"""The parts of an identification of all valves, each built on those before it. Pure."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Self

from valvemap.pipeline.alarm_states import AlarmRule
from valvemap.pipeline.alignment import Alignment
from valvemap.pipeline.all_alarms import AllAlarms
from valvemap.pipeline.all_valves import AllValves
from valvemap.pipeline.approved_maps import ApprovedMaps
from valvemap.pipeline.armed_valves import ArmedValves
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.demand_leads import DemandLeads
from valvemap.pipeline.dynamics_reference import DynamicsReferences
from valvemap.pipeline.estimator_commands import EstimatorCommands
from valvemap.pipeline.kept_columns import KeptColumns
from valvemap.pipeline.kept_states import KeptStates
from valvemap.pipeline.line_inverse import LineInverse
from valvemap.pipeline.maps_and_surveys import MapsAndSurveys
from valvemap.pipeline.result_tables import ResultTables
from valvemap.pipeline.sample_intake import SampleIntake
from valvemap.pipeline.timing import Timing
from valvemap.pipeline.valve_state import ValvePlan
from valvemap.vocabulary.commands import Subject
from valvemap.vocabulary.service_alarms import ServiceAlarm


@dataclass(frozen=True)
class Parts:
    """The state of all valves; :class:`Identification` alone may change it.

    Attributes
    ----------
    arrivals, valves, intake
        Changes to samples, the valves' states, and samples to the valves.
    maps, lines, results
        Inverse tables and surveys, the inverse of 4/3 valves' lines, and the published results.
    leads, commands, references, approved, alarms, armed
        The operators' commands, and comparisons with the maps that they approved.
    kept, columns
        The whole state as bytes, and as columns.
    """

    arrivals: Arrivals
    valves: AllValves
    intake: SampleIntake
    maps: MapsAndSurveys
    leads: DemandLeads
    commands: EstimatorCommands
    references: DynamicsReferences
    approved: ApprovedMaps
    alarms: AllAlarms
    armed: ArmedValves
    lines: LineInverse
    results: ResultTables
    kept: KeptStates
    columns: KeptColumns

    @classmethod
    def of(
        cls,
        plans: Sequence[ValvePlan],
        alignment: Alignment,
        timing: Timing | None,
        service_alarms: Mapping[ServiceAlarm, AlarmRule],
        waits: Collection[str],
    ) -> Self:
        """Build the parts; parameters as of :class:`Identification`."""
        arrivals = Arrivals([plan.name for plan in plans], alignment, timing)
        valves = AllValves(plans, arrivals.timing, waits)
        intake = SampleIntake(valves, arrivals)
        maps, lines = MapsAndSurveys(valves, intake), LineInverse(valves, intake)
        leads, references = DemandLeads(valves.plans), DynamicsReferences()
        commands = EstimatorCommands(valves, leads)
        approved = ApprovedMaps(valves, commands, references)
        alarms, armed = AllAlarms(valves, service_alarms), ArmedValves(valves)
        results = ResultTables(valves, arrivals, intake, maps, approved, armed, commands, lines)
        kept = KeptStates(
            valves, arrivals, approved, alarms, maps, intake.splitter, intake.meters, references
        )
        return cls(
            arrivals=arrivals,
            valves=valves,
            intake=intake,
            maps=maps,
            leads=leads,
            commands=commands,
            references=references,
            approved=approved,
            alarms=alarms,
            armed=armed,
            lines=lines,
            results=results,
            kept=kept,
            columns=KeptColumns(valves, intake, approved),
        )

    def executor_of(self, subject: Subject) -> object:
        """Return the part whose methods carry out the commands on a subject."""
        match subject:
            case Subject.ESTIMATOR | Subject.DEMAND:
                return self.commands
            case Subject.BASELINE:
                return self.approved
            case Subject.INVERSE:
                return self.armed
            case Subject.ALARM:
                return self.alarms
