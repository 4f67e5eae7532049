"""What an operator does about a valve's approved map, at a running service."""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from service.app.identities import PAGE_NAME, PAGE_URI
from service.hardened.security.certificates import Pki, ensure_certificate
from service.opcua.results_client import ResultsClient, Security, SourceSettings

_NAMESPACE = "urn:valvemap:service"


class Action(StrEnum):
    """What can be done."""

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


@dataclass(frozen=True)
class Service:
    """The running service and who we are there; ``pki`` is that of the page."""

    url: str
    security: Security
    pki: Path
    user: str | None = None
    password: str | None = None


async def act(service: Service, valve: str, action: Action, estimator: str = "Auto") -> str:
    """Do it, and say how the valve stands then, in a line.

    Raises
    ------
    CommandRejected
        if the service refuses it: in its words.
    SourceLost, SourceRejected
    """
    client, node = ResultsClient(_settings(service), _NAMESPACE), f"{valve}.Baseline"
    await client.connect()
    try:
        if action is Action.COMPARE:
            ((mean, largest, U, dp, points),) = await client.call(node, "Compare", [[estimator]])
            return (
                f"{valve}.{estimator}: {mean:+.3g} l/min on average, {largest:+.3g} at most (at "
                f"U = {U:.3g} %, dp = {dp:.3g} bar), at {points} points"
            )
        if action in _METHODS:
            await client.call(node, _METHODS[action], [[]])
        version, digest = await client.read([f"{node}.Version", f"{node}.DataHash"])
        if not version.value:
            return f"{valve}: no map is approved"
        return f"{valve}: builds on {version.value}, SHA-256 {digest.value}"
    finally:
        await client.close()


def _settings(service: Service) -> SourceSettings:
    own = None
    if service.security is not Security.NONE:
        names = ("localhost", "127.0.0.1")
        own = ensure_certificate(Pki(service.pki), PAGE_URI, names, PAGE_NAME.replace(" ", "-"))
    return SourceSettings(
        url=service.url,
        security=service.security,
        pki=None if own is None else Pki(service.pki),
        own=own,
        user=service.user,
        password=service.password,
        application_uri=None if own is not None else PAGE_URI,
    )
