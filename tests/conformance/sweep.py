"""Sweeps of our servers by other stacks: every node and attribute, every method, every aggregate.

Each stack walks, reads and calls by itself; what it counts is a row of `docs/conformance.md`.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from asyncua import ua

from conformance.past import AGGREGATES, disagreement, past_server
from support.own_servers import rig, service
from support.peer import Peer

ATTRIBUTES = list(range(1, 28))
READ_AT_ONCE = 500  # nodes per line to a program; each is read in a separate request
TOO_MANY = 30  # arguments, so that no method is executed
REFERENCES, HIERARCHICAL = "i=31", "i=33"
ROOT, OBJECTS = "i=84", "i=85"
INT32 = f"i={ua.ObjectIds.Int32}"
FAILED = {ua.StatusCodes.BadInternalError, ua.StatusCodes.BadEncodingError}
DENIED = ua.StatusCodes.BadUserAccessDenied
WRONG_ARGUMENTS = {ua.StatusCodes.BadTooManyArguments, ua.StatusCodes.BadInvalidArgument}


@dataclass(frozen=True)
class Swept:
    """Result of one stack at one server."""

    nodes: int
    attributes: int
    faults: int  # requests refused as a whole
    failed: int  # attributes that failed unexpectedly
    methods: int
    denied: int  # methods that this user, an observer, may not call
    dead: int  # methods that answer neither that, nor that the arguments are wrong
    codes: int  # variables of codes
    untyped: int  # of these, those that are a bare Int32


SERVERS = {"service": service, "rig": rig}


async def sweeps(program, folder) -> Mapping[str, object]:
    """Return the results of one stack at both servers, and those of its aggregates."""
    peer = await Peer.start(*program)
    try:
        found = {}
        for name, server in SERVERS.items():
            (folder / name).mkdir()
            async with server(folder / name) as url:
                found[name] = vars(await swept(peer, url))
        async with past_server() as (url, past):
            found["aggregates"] = await aggregated(peer, url, past)
    finally:
        await peer.stop()
    return found


async def swept(peer, url) -> Swept:
    await peer.ask("connect", url=url)
    nodes = (await peer.ask("walk", root=ROOT, reference=REFERENCES))["nodes"]
    counts, faults, types = {}, 0, {}
    for first in range(0, len(nodes), READ_AT_ONCE):
        some = nodes[first : first + READ_AT_ONCE]
        read = await peer.ask("readEvery", nodes=some, attributes=ATTRIBUTES)
        faults += len(read["faults"])
        types |= read["types"]
        for code, n in read["codes"].items():
            counts[int(code)] = counts.get(int(code), 0) + n
    answers = await answers_of_methods(peer)
    await peer.ask("disconnect")
    known = set(nodes)
    coded = {id_: type_ for id_, type_ in types.items() if f"{id_}.EnumStrings" in known}
    return Swept(
        nodes=len(nodes),
        attributes=sum(counts.values()),
        faults=faults,
        failed=sum(n for code, n in counts.items() if code in FAILED),
        methods=len(answers),
        denied=list(answers.values()).count(DENIED),
        dead=len(dead_methods(answers)),
        codes=len(coded),
        untyped=sum(type_.removeprefix("ns=0;") == INT32 for type_ in coded.values()),
    )


async def answers_of_methods(peer):
    """Call every method with too many arguments; return its StatusCode by owner and method."""
    below = await peer.ask("walk", root=OBJECTS, reference=HIERARCHICAL)
    arguments = [{"type": "Double", "value": 0.0}] * TOO_MANY
    return {
        (owner, method): (await peer.ask("call", owner=owner, method=method, inputs=arguments))[
            "code"
        ]
        for owner, method in sorted({tuple(pair) for pair in below["methods"]})
    }


def dead_methods(answers):
    """Those that answer neither that they are denied, nor that the arguments are wrong."""
    return [of for of, code in answers.items() if code not in {DENIED, *WRONG_ARGUMENTS}]


async def aggregated(peer, url, past):
    """Return how many aggregates were read, and how those differ that are not as computed here."""
    await peer.ask("connect", url=url)
    answers = {name: await peer.ask("history", **past.asked(name)) for name in AGGREGATES}
    await peer.ask("disconnect")
    wrong = [disagreement(name, past, found) for name, found in answers.items()]
    return {"read": len(answers), "wrong": [one for one in wrong if one]}
