"""Operator actions on a valve's approved map (baseline), at a running service."""

from enum import StrEnum

from valvemap.app.page_access import Watched, settings_of
from valvemap.errors import CommandRejected
from valvemap.opcua_client.nodes_client import UNKNOWN_NODE
from valvemap.opcua_client.results_client import ResultsClient
from valvemap.opcua_results.namespaces import SERVICE_NAMESPACE


class Action(StrEnum):
    """The actions on a baseline."""

    SHOW = "show"
    COMPARE = "compare"
    APPROVE = "approve"
    ROLL_BACK = "roll-back"
    REPLACED = "replaced"


_METHODS = {
    Action.APPROVE: "Approve",
    Action.ROLL_BACK: "RollBack",
    Action.REPLACED: "ValveReplaced",
}


_INVALID_STATE = "BadInvalidState"


async def act(service: Watched, valve: str, action: Action, estimator: str = "Auto") -> str:
    """Carry out an action; return the resulting state of the valve as one line.

    Raises
    ------
    CommandRejected
        if the service rejects it; with the service's message.
    SourceLost, SourceRejected
    """
    client = ResultsClient(settings_of(service), SERVICE_NAMESPACE)
    await client.connect()
    try:
        return await _done(client, valve, action, estimator)
    except CommandRejected as refusal:
        raise await _in_its_words(client, valve, refusal) from None
    finally:
        await client.close()


async def _done(client: ResultsClient, valve: str, action: Action, estimator: str) -> str:
    node = f"{valve}.Baseline"
    if action is Action.COMPARE:
        ((mean, largest, U, dp, points),) = await client.call(node, "Compare", [[estimator]])
        return (
            f"{valve}.{estimator}: {mean:+.3g} l/min on average, {largest:+.3g} at most (at "
            f"U = {U:.3g} %, Δp = {dp:.3g} bar); {points} points compared"
        )
    if action in _METHODS:
        await client.call(node, _METHODS[action], [[]])
    version, digest = await client.read([f"{node}.Version", f"{node}.DataHash"])
    if version.code == UNKNOWN_NODE:
        raise CommandRejected(f"{valve}: the service has no such valve")
    if not version.value:
        return f"{valve}: no map is approved"
    return f"{valve}: builds on {version.value}, SHA-256 {digest.value}"


async def _in_its_words(
    client: ResultsClient, valve: str, refusal: CommandRejected
) -> CommandRejected:
    """Return the error with the service's reason, which a method's StatusCode does not carry."""
    if _INVALID_STATE not in str(refusal):
        return refusal
    (said,) = await client.read([f"{valve}.Baseline.LastRefusal"])
    return CommandRejected(str(said.value)) if said.value else refusal
