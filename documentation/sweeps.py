"""The table of `docs/conformance.md` that other stacks' sweeps fill (``make conformance``)."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from documentation.tables import table

BEGIN, END = "<!-- sweeps: made by `make conformance` -->", "<!-- end of sweeps -->"
PAGE = Path(__file__).parents[1] / "docs" / "conformance.md"
RESULTS = PAGE.parent / "reference" / "sweeps.json"
_HEADINGS = (
    *("stack", "server", "nodes", "attributes read", "requests refused", "attributes failed"),
    *("methods called", "denied to an observer", "not implemented", "variables of codes"),
    "bare Int32",
)


def with_sweeps(text: str, results: Mapping[str, Any]) -> str:
    r"""Return the page with its tables of sweeps replaced.

    >>> with_sweeps(f"a\n{BEGIN}\nold\n{END}\nb", {}).splitlines()[-1]
    'b'
    """
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n\n{_tables(results)}\n\n{END}{after}"


def kept_results() -> dict[str, Any]:
    """Return the results of the last sweeps, by stack."""
    found: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8"))
    return found


def write(results: Mapping[str, Any]) -> None:
    """Write the results of sweeps, and the page's tables."""
    RESULTS.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
    page = with_sweeps(PAGE.read_text(encoding="utf-8"), results)
    PAGE.write_text(page, encoding="utf-8")


def _tables(results: Mapping[str, Any]) -> str:
    rows = [
        [f"{stack} {found['version']}", server, *(f"{n:,}" for n in found[server].values())]
        for stack, found in results.items()
        for server in ("service", "rig")
    ]
    aggregates = [
        [
            f"{stack} {found['version']}",
            str(found["aggregates"]["read"]),
            str(found["aggregates"]["read"] - len(found["aggregates"]["wrong"])),
            "; ".join(found["aggregates"]["wrong"]) or "none",
        ]
        for stack, found in results.items()
    ]
    headings = ["stack", "aggregates read", "equal to the formulas", "differences"]
    return f"{table(_HEADINGS, rows)}\n\n{table(headings, aggregates)}"
