"""The state of a condition, and its event (Part 9, 5.5 to 5.8); no I/O.

There are no branches: an alarm that becomes active again before it is acknowledged stays the same
condition. It is retained while it is active, unacknowledged or unconfirmed (annex B.1).
"""

import hashlib
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from asyncua import ua

from guarded_opcua.binary.encoding import instant
from guarded_opcua.monitoring.events import Event

_Ids = ua.ObjectIds
_Types = ua.VariantType
_EVENT_ID = struct.Struct("<qqB")  # activation number, time of the change, state flags
_DIGEST_BYTES = 15
_LOCALE = "en"


class ConditionClass(Enum):
    """ConditionClass (Part 9, 5.9)."""

    PROCESS = _Ids.ProcessConditionClassType
    MAINTENANCE = _Ids.MaintenanceConditionClassType
    SYSTEM = _Ids.SystemConditionClassType


class ConditionKind(Enum):
    """Type of a condition, which defines when it is active."""

    OFF_NORMAL = _Ids.OffNormalAlarmType
    ABOVE_LIMIT = _Ids.ExclusiveLimitAlarmType
    BELOW_LIMIT = -_Ids.ExclusiveLimitAlarmType


@dataclass(frozen=True)
class ConditionKey:
    """Static data of a condition, independent of its state.

    Attributes
    ----------
    id
        ConditionId, the identifier of its node.
    name
        ConditionName.
    source, source_name
        Source node and its name.
    emitters
        Objects whose subscribers receive the events.
    """

    id: ua.NodeId
    name: str
    kind: ConditionKind
    category: ConditionClass
    source: ua.NodeId
    source_name: str
    emitters: tuple[ua.NodeId, ...]

    @property
    def type_definition(self) -> ua.NodeId:
        """NodeId of the condition's type."""
        return ua.NodeId(abs(self.kind.value))


@dataclass(frozen=True)
class Condition:
    """The state of a condition.

    Attributes
    ----------
    severity
        1 … 1,000.
    message
        Message of the event.
    coming
        Number of activations.
    changed
        Time of the last activation, deactivation, acknowledgement or confirmation, UTC ns.
    begun, ended
        Time of the last activation, and of the deactivation after it (0: active, or unknown), UTC
        ns.
    limit
        Limit of a limit alarm.
    comment, commented_by, commented
        Last comment, its user, and its time (UTC ns; 0: never).
    """

    key: ConditionKey
    active: bool
    acked: bool
    confirmed: bool
    severity: int
    message: str
    coming: int
    changed: int
    begun: int = 0
    ended: int = 0
    limit: float = 0.0
    comment: str = ""
    commented_by: str = ""
    commented: int = 0

    @property
    def retain(self) -> bool:
        """Whether ConditionRefresh includes the condition."""
        return self.active or not self.acked or not self.confirmed

    @property
    def turned(self) -> int:
        """Time at which ActiveState was entered, UTC ns; 0: unknown."""
        return self.begun if self.active else self.ended

    @property
    def event_id(self) -> bytes:
        """EventId of the last change; deterministic, so it survives a restart."""
        remarked = self.commented > self.changed
        moment = self.commented if remarked else self.changed
        flags = self.active, self.acked, self.confirmed, remarked
        stands = sum(flag << bit for bit, flag in enumerate(flags))
        return _signed(self.key.id, _EVENT_ID.pack(self.coming, moment, stands))

    def event(self) -> Event:
        """Return the event of the last change."""
        kind = self.key.type_definition
        return Event(self.key.emitters, kind, self.fields(), condition=self.key.id)

    def is_told_by(self, event_id: object) -> bool:
        """Return whether an EventId belongs to the current activation; older ones are rejected."""
        if not isinstance(event_id, bytes) or len(event_id) != _EVENT_ID.size + _DIGEST_BYTES:
            return False
        content = event_id[: _EVENT_ID.size]
        return event_id == _signed(self.key.id, content) and (
            _EVENT_ID.unpack(content)[0] == self.coming
        )

    def fields(self) -> Mapping[str, ua.Variant]:
        """Return all event fields by browse path; times are those of the last change."""
        key, now = self.key, instant(max(self.changed, self.commented))
        commented, changed = instant(self.commented), instant(self.changed)
        category = ua.NodeId(key.category.value)
        return {
            "EventId": ua.Variant(self.event_id, _Types.ByteString),
            "EventType": ua.Variant(key.type_definition, _Types.NodeId),
            "SourceNode": ua.Variant(key.source, _Types.NodeId),
            "SourceName": ua.Variant(key.source_name, _Types.String),
            "Time": ua.Variant(now, _Types.DateTime),
            "ReceiveTime": ua.Variant(now, _Types.DateTime),
            "Message": _text(self.message),
            "Severity": ua.Variant(self.severity, _Types.UInt16),
            "ConditionClassId": ua.Variant(category, _Types.NodeId),
            "ConditionClassName": _text(f"{key.category.name.capitalize()}ConditionClassType"),
            "ConditionName": ua.Variant(key.name, _Types.String),
            "BranchId": ua.Variant(ua.NodeId(), _Types.NodeId),
            "Retain": _flag(self.retain),
            "EnabledState": _text("Enabled"),
            "EnabledState/Id": _flag(True),  # noqa: FBT003 - a value
            "Quality": ua.Variant(ua.StatusCode(), _Types.StatusCode),
            "Quality/SourceTimestamp": ua.Variant(changed, _Types.DateTime),
            "LastSeverity": ua.Variant(self.severity, _Types.UInt16),
            "LastSeverity/SourceTimestamp": ua.Variant(changed, _Types.DateTime),
            "Comment": _text(self.comment),
            "Comment/SourceTimestamp": ua.Variant(commented, _Types.DateTime),
            "ClientUserId": ua.Variant(self.commented_by, _Types.String),
            "AckedState": _text("Acknowledged" if self.acked else "Unacknowledged"),
            "AckedState/Id": _flag(self.acked),
            "ConfirmedState": _text("Confirmed" if self.confirmed else "Unconfirmed"),
            "ConfirmedState/Id": _flag(self.confirmed),
            "ActiveState": _text("Active" if self.active else "Inactive"),
            "ActiveState/Id": _flag(self.active),
            "ActiveState/TransitionTime": ua.Variant(instant(self.turned), _Types.DateTime),
            "InputNode": ua.Variant(ua.NodeId(), _Types.NodeId),
            "SuppressedOrShelved": _flag(False),  # noqa: FBT003 - a value
            **self._of_kind(),
        }

    def _of_kind(self) -> Mapping[str, ua.Variant]:
        if self.key.kind is ConditionKind.OFF_NORMAL:
            return {"NormalState": ua.Variant(ua.NodeId(), _Types.NodeId)}
        above = self.key.kind is ConditionKind.ABOVE_LIMIT
        name = "High" if above else "Low"
        state = getattr(_Ids, f"ExclusiveLimitStateMachineType_{name}")
        return {
            f"{name}Limit": ua.Variant(self.limit, _Types.Double),
            "LimitState/CurrentState": _text(name if self.active else ""),
            "LimitState/CurrentState/Id": ua.Variant(
                ua.NodeId(state) if self.active else ua.NodeId(), _Types.NodeId
            ),
        }


def event_fields() -> tuple[str, ...]:
    """Return the browse paths of all event fields of all kinds of conditions.

    >>> [path for path in event_fields() if path.endswith("Limit")]
    ['HighLimit', 'LowLimit']
    """
    nobody, found = ua.NodeId(), dict[str, ua.Variant]()
    for kind in ConditionKind:
        key = ConditionKey(nobody, "", kind, ConditionClass.PROCESS, nobody, "", ())
        found |= Condition(
            key,
            active=False,
            acked=True,
            confirmed=True,
            severity=1,
            message="",
            coming=0,
            changed=0,
        ).fields()
    return tuple(found)


def _signed(condition: ua.NodeId, content: bytes) -> bytes:
    digest = hashlib.blake2b(content, key=condition.to_string().encode()[:64])
    return content + digest.digest()[:_DIGEST_BYTES]


def _flag(value: bool) -> ua.Variant:  # noqa: FBT001 - a value
    return ua.Variant(value, _Types.Boolean)


def _text(value: str) -> ua.Variant:
    return ua.Variant(ua.LocalizedText(value, _LOCALE), _Types.LocalizedText)
