"""First messages to a new viewer: the connection, the places, and the words of all codes. Pure."""

from collections.abc import Iterator
from typing import Any

from valvemap.page.judgement import INVERSE_SEVERITIES, STATUS_SEVERITIES, Reason
from valvemap.page.layout import family_of, part_of
from valvemap.page.machine_parts import words_of_codes
from valvemap.page.observer import Observer
from valvemap.vocabulary.alarm_guide import GUIDES
from valvemap.vocabulary.health import DeviceHealth
from valvemap.vocabulary.quantities import ESTIMATOR_QUANTITIES
from valvemap.vocabulary.signals import SENSORS, Signal
from valvemap.vocabulary.statuses import Adaptation, InverseStatus, Status


def greeting(observer: Observer) -> dict[str, Any]:
    """Return the greeting, for the browser."""
    return {
        "link": observer.link.value,
        "text": observer.link_text,
        "since": observer.link_since / 1e6,
        "start": observer.start,
        "url": observer.client.url,
        "generation": observer.generation,
        "valves": [
            {
                "name": valve.name,
                "estimators": valve.estimators,
                "primary": valve.primary,
                "family": family_of(valve.name),
                "kind": part.kind if (part := part_of(valve)) else "",
            }
            for valve in observer.valves
        ],
        "parts": [{"name": axis.name, "kind": axis.kind, "family": ""} for axis in observer.parts],
        "quantities": [
            {
                "name": q.name,
                "heading": q.heading,
                "unit": q.unit,
                "decimals": q.decimals,
                "about": q.sentence,
            }
            for q in ESTIMATOR_QUANTITIES
            if q.heading
        ],
        "words": {
            "status": [(s.label, s.sentence, STATUS_SEVERITIES[s]) for s in Status],
            "adaptation": [(state.label, state.sentence) for state in Adaptation],
            "inverse": [
                (INVERSE_SEVERITIES[s], s.sentence, s.label, s is not InverseStatus.NOT_FINITE)
                for s in InverseStatus  # the last: whether there was a demand to answer
            ],
            "reason": [(reason.label, reason.sentence, reason.is_old) for reason in Reason],
            "health": [(health.label, health.sentence) for health in DeviceHealth],
            "codes": words_of_codes(),
            "guides": {name: (guide.quantity, guide.action) for name, guide in GUIDES.items()},
            "signals": dict(_signals()),
        },
    }


def _signals() -> Iterator[tuple[str, tuple[str, str]]]:
    """Yield name, caption and unit of each signal, the pressure drop behind its pressures."""
    for signal in SENSORS:
        yield signal.label, (signal.caption, signal.unit)
        if signal is Signal.P2:
            yield "dp", ("Δp", "bar")
