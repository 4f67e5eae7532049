"""Model changes from one configuration to the next (Part 3, 9.32; Part 5, 12.16). Pure.

A NodeVersion is a digest of the model: the same model has the same version after a restart and on
another machine. A client that cached the version can tell whether it must browse again.
"""

import hashlib
from collections.abc import Iterable, Sequence

from asyncua import ua

from guarded_opcua import Event, instant
from valvemap.opcua_results.information_model import ROOT
from valvemap.pipeline.results import ValveDescription

_SERVER = ua.NodeId(ua.ObjectIds.Server)
_KIND = ua.NodeId(ua.ObjectIds.GeneralModelChangeEventType)
_SEVERITY = 100
_MOST_NAMED = 10  # valves or axes, in the message
_Verb = ua.ModelChangeStructureVerbMask
_Types = ua.VariantType


def version_of_root(valves: Iterable[ValveDescription], axes: Iterable[str] = ()) -> str:
    """NodeVersion of ``s=Identification``: changes when a valve or an axis comes, goes or changes.

    >>> one, two = ValveDescription("V1", ()), ValveDescription("V2", ())
    >>> version_of_root([one, two]) == version_of_root([two, one]) != version_of_root([one])
    True
    >>> version_of_root([one], ["Press"]) != version_of_root([one])
    True
    """
    versions = sorted((valve.name, version_of_valve(valve)) for valve in valves)
    return _digest((versions, sorted(axes)))


def version_of_valve(valve: ValveDescription) -> str:
    """NodeVersion of a valve: changes whenever its nodes are re-created."""
    return _digest(valve)


def model_change(
    before: Sequence[ValveDescription],
    after: Sequence[ValveDescription],
    index: int,
    valve_type: ua.NodeId,
    now: int,
) -> Event | None:
    """Return the event that lists added, removed and changed valves; None if there are none.

    Parameters
    ----------
    before, after
        The valves shown before and after the change.
    index
        Index of our namespace.
    valve_type
        NodeId of the ValveType.
    now
        Time of the event, UTC ns.
    """
    old, new = ({valve.name: valve for valve in valves} for valves in (before, after))
    came = [name for name in new if name not in old]
    went = [name for name in old if name not in new]
    changed = [name for name in new if name in old and old[name] != new[name]]
    return _change_of("Valves", came, went, changed, index, valve_type, now)


def axes_change(before: Sequence[str], after: Sequence[str], index: int, now: int) -> Event | None:
    """Return the event that lists added and removed axes; None if there are none.

    Axes that stay are re-created, with a reload that changes nothing of their nodes.
    """
    came = [name for name in after if name not in before]
    went = [name for name in before if name not in after]
    kind = ua.NodeId(ua.ObjectIds.BaseObjectType)
    return _change_of("Axes", came, went, [], index, kind, now)


def _change_of(
    what: str,
    came: Sequence[str],
    went: Sequence[str],
    changed: Sequence[str],
    index: int,
    kind: ua.NodeId,
    now: int,
) -> Event | None:
    if not (came or went or changed):
        return None
    root = ua.NodeId(ROOT, index)
    verbs = [(name, _Verb.NodeAdded) for name in came]
    verbs += [(name, _Verb.NodeDeleted) for name in went]
    verbs += [(name, _Verb.NodeAdded | _Verb.NodeDeleted) for name in changed]  # re-created
    changes = [_change(ua.NodeId(name, index), kind, verb) for name, verb in verbs]
    if came or went:
        verb = (_Verb.ReferenceAdded if came else 0) | (_Verb.ReferenceDeleted if went else 0)
        changes.append(_change(root, ua.NodeId(ua.ObjectIds.BaseObjectType), verb))
    said = "; ".join(
        f"{word}: {', '.join(names[:_MOST_NAMED])}{' …' if len(names) > _MOST_NAMED else ''}"
        for word, names in (("added", came), ("removed", went), ("changed", changed))
        if names
    )
    return _event(changes, f"{what} {said}", root, now)


def _event(
    changes: list[ua.ModelChangeStructureDataType], said: str, root: ua.NodeId, now: int
) -> Event:
    moment, what = instant(now), f"{now} {changes}"
    fields = {
        "EventId": ua.Variant(hashlib.sha256(what.encode()).digest()[:16], _Types.ByteString),
        "EventType": ua.Variant(_KIND, _Types.NodeId),
        "SourceNode": ua.Variant(_SERVER, _Types.NodeId),
        "SourceName": ua.Variant("Server", _Types.String),
        "Time": ua.Variant(moment, _Types.DateTime),
        "ReceiveTime": ua.Variant(moment, _Types.DateTime),
        "Message": ua.Variant(ua.LocalizedText(said, "en"), _Types.LocalizedText),
        "Severity": ua.Variant(_SEVERITY, _Types.UInt16),
        "Changes": ua.Variant(changes, _Types.ExtensionObject, is_array=True),
    }
    return Event((_SERVER, root), _KIND, fields)


def _change(affected: ua.NodeId, kind: ua.NodeId, verb: int) -> ua.ModelChangeStructureDataType:
    return ua.ModelChangeStructureDataType(Affected=affected, AffectedType=kind, Verb=verb)


def _digest(what: object) -> str:
    return hashlib.sha256(repr(what).encode()).hexdigest()[:16]
