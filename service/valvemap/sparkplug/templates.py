"""Valves as instances of templates, as Sparkplug 3.0 defines them in chapter 6.4.18. Pure.

Devices with equal metrics share one definition, which NBIRTH publishes: names, data types, units
and descriptions. The DBIRTH of a device is one instance with all members, their values and ranges;
its DDATA are instances with the changed members, by alias.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from hashlib import sha256
from itertools import count
from typing import Any, Final

from valvemap.sparkplug.metrics import Tag, add_declaration, add_member, add_template
from valvemap.sparkplug.structures import Bearing, Change, add_changes

INSTANCE: Final = "Valve"
"""Name of the metric that is the instance; its template's name is this with a digest."""
_FIRST_ALIAS: Final = 2**24  # of instances: above those of variables, which count from 1
_DIGITS: Final = 8  # of the digest in a template's name


class Templates:
    """One metric per device: an instance of the template of all devices with equal metrics.

    Equal metrics give the same template name at every edge node and after every restart; other
    metrics, such as those of one more estimator, give another name.

    Examples
    --------
    >>> from valvemap.sparkplug.schema import DataType, Payload
    >>> flow = Tag("V1.Signals.Q", "V1", "Signals/Q", DataType.DOUBLE, alias=1)
    >>> payload, templates = Payload(), Templates()
    >>> templates.define(payload, {"V1": [flow]}, now=0)
    >>> payload.metrics[0].name, payload.metrics[0].template_value.is_definition
    ('Valve 686a9a9b', True)
    """

    prefix: Final = f"{INSTANCE}/"

    def __init__(self) -> None:
        self._names: dict[str, str] = {}
        self._aliases: dict[str, int] = {}
        self._next_alias = count(_FIRST_ALIAS)

    def define(self, payload: Any, tags: Mapping[str | None, Sequence[Tag]], now: int) -> None:  # noqa: ANN401
        """Add the definitions of the devices' templates to NBIRTH."""
        self._names = {device: _name_of(own) for device, own in tags.items() if device is not None}
        defined: set[str] = set()
        for device, name in self._names.items():
            if device not in self._aliases:
                self._aliases[device] = next(self._next_alias)
            if name in defined:
                continue
            defined.add(name)
            template = add_template(payload, now, name=name)
            template.is_definition = True
            for tag in tags[device]:
                add_declaration(template, tag, now)

    def bear(self, payload: Any, device: str, metrics: Bearing, now: int) -> None:  # noqa: ANN401
        """Add the instance of a device, with all members, to its DBIRTH."""
        template = self._instance(payload, device, now, name=INSTANCE)
        for tag, value in metrics:
            add_member(template, tag, value)

    def change(self, payload: Any, device: str, changes: Iterable[Change], born: int) -> None:  # noqa: ANN401
        """Add instances with the changed members to a DDATA; each has a member at most once."""
        for some in _rounds(changes, born):
            template = self._instance(payload, device, some[-1].value.t)
            if some[0].number <= born:
                payload.metrics[-1].is_historical = True
            add_changes(template, some, born)

    def _instance(self, payload: Any, device: str, t: int, **identity: str) -> Any:  # noqa: ANN401
        template = add_template(payload, t, alias=self._aliases[device], **identity)
        template.template_ref, template.is_definition = self._names[device], False
        return template


def _rounds(changes: Iterable[Change], born: int) -> Iterator[list[Change]]:
    """Split changes where a metric comes again, and where the historical ones end."""
    some: list[Change] = []
    there: set[int] = set()
    for change in changes:
        alias = change.tag.alias
        if some and (alias in there or (some[0].number <= born) != (change.number <= born)):
            yield some
            some, there = [], set()
        some.append(change)
        there.add(alias)
    if some:
        yield some


def _name_of(tags: Sequence[Tag]) -> str:
    members = [(tag.name, int(tag.kind), tag.meaning.unit, tag.meaning.description) for tag in tags]
    return f"{INSTANCE} {sha256(repr(members).encode()).hexdigest()[:_DIGITS]}"
