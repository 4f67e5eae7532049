"""The report as one self-contained HTML page with embedded pictures."""

import base64
import math
from collections import Counter
from collections.abc import Iterable
from html import escape
from string import Template
from typing import Final

from paper.build import PaperReport
from paper.erratum import Erratum
from paper.picture import Picture
from paper.verdict import Claim, Part, Verdict

_MARKS: Final = {
    Verdict.REPRODUCED: "yes",
    Verdict.EXPLAINED: "misprint",
    Verdict.NOT_REPRODUCED: "no",
}
_SEE: Final = {
    1: (("table-1", "Table 1"), ("lambda-sweep", "sweep of λ"), ("damage", "damage")),
    2: (("table-1", "Table 1"), ("courses", "courses")),
    3: (("courses", "courses"),),
    4: (("lambda-sweep", "sweep of λ"), ("courses", "courses")),
    5: (("table-2", "Table 2"), ("courses", "courses")),
    6: (("courses", "courses"),),
    7: (("extrapolation", "extrapolation"),),
    13: (("damage", "damage"),),
}


def html_page(report: PaperReport) -> str:
    """Return the page.

    All claims, numbers and verdicts come from the report; the template contains only text that
    holds for any data.
    """
    return _PAGE.substitute(
        counts=_counts(report.claims),
        faster=f"{report.faster_hz:g}",
        summary="\n".join(
            _summary_row(claim, other, report.sets)
            for claim, other in zip(report.claims, report.claims_faster, strict=True)
        ),
        recordings=escape(
            f"{report.sets} sets of recordings, {report.samples:,} samples each "
            f"({report.rate_hz:g} a second), each set with other noise and other scattered points"
        ),
        figures="\n".join(map(_figure, report.figures)),
        tables="\n".join(map(_figure, report.tables)),
        runs="\n".join(map(_figure, report.runs)),
        claims="\n".join(_claim(claim, report.sets) for claim in report.claims),
        shown=sum(erratum.shown for erratum in report.errata),
        all_errata=len(report.errata),
        errata="\n".join(map(_erratum_row, report.errata)),
    )


def figure_text(value: float | None, unit: str = "") -> str:
    """Format a figure with its unit.

    >>> figure_text(0.12345), figure_text(math.inf), figure_text(240.0, "bytes")
    ('0.123', '∞', '240 bytes')
    """
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞"
    text = f"{value:,.0f}" if value == round(value) and abs(value) < 1e7 else f"{value:.3g}"
    return f"{text} {unit}".rstrip()


def _counts(claims: Iterable[Claim]) -> str:
    counted = Counter(claim.verdict for claim in claims)
    return "\n".join(
        f'<li class="{_MARKS[verdict]}"><b>{counted[verdict]}</b> {verdict}</li>'
        for verdict in Verdict
    )


def _summary_row(claim: Claim, faster: Claim, sets: int) -> str:
    other = "the same" if faster.verdict is claim.verdict else _badge(faster.verdict)
    return (
        f'<tr><td><a href="#claim-{claim.number}">{claim.number}</a></td>'
        f"<td>{escape(claim.text)}</td><td>{_badge(claim.verdict)}</td>"
        f"<td class=num>{claim.agreeing} of {claim.sets or sets}</td><td>{other}</td></tr>"
    )


def _badge(verdict: Verdict) -> str:
    return f'<span class="badge {_MARKS[verdict]}">{verdict}</span>'


def _figure(picture: Picture) -> str:
    image = base64.b64encode(picture.png).decode("ascii")
    return (
        f'<figure id="{picture.key}"><figcaption><b>{escape(picture.title)}.</b> '
        f"{escape(picture.caption)}</figcaption>"
        f'<img alt="{escape(picture.title)}" src="data:image/png;base64,{image}"></figure>'
    )


def _claim(claim: Claim, sets: int) -> str:
    rows = "\n".join(map(_part_row, claim.parts))
    see = ", ".join(f'<a href="#{key}">{name}</a>' for key, name in _SEE.get(claim.number, ()))
    note = f"{escape(claim.note)} {f'See {see}.' if see else ''}"
    return (
        f'<section class=claim id="claim-{claim.number}">'
        f"<h3>{claim.number}. {escape(claim.text)}</h3>"
        f"<p>{_badge(claim.verdict)} <small>the same in {claim.agreeing} of {claim.sets or sets} "
        "sets of recordings</small></p>"
        "<table class=parts><thead><tr><th>what the claim says<th>figure<th>as printed"
        f"<th>claim holds if<th>holds</tr></thead><tbody>{rows}</tbody></table>"
        f"<p class=note>{note}</p></section>"
    )


def _part_row(part: Part) -> str:
    printed = ""
    if part.printed:
        printed = f"{figure_text(part.value_as_printed, part.unit)} <small>{escape(part.erratum)}"
        printed += f"</small><br>{_spread(part.printed)}"
    held = "yes" if part.holds else ("as printed" if part.explained else "no")
    mark = "yes" if part.holds else ("misprint" if part.explained else "no")
    return (
        f"<tr><td>{escape(part.says)}</td>"
        f"<td class=num>{figure_text(part.value, part.unit)}<br>{_spread(part.values)}</td>"
        f"<td class=num>{printed}</td>"
        f"<td>{part.must} {figure_text(part.limit, part.unit)}<br><small>{escape(part.why)}"
        f'</small></td><td><span class="held {mark}">{held}</span></td></tr>'
    )


def _spread(values: tuple[float, ...]) -> str:
    known = [value for value in values if not math.isnan(value)]
    if not known or min(known) == max(known):
        return ""
    return f"<small>{figure_text(min(known))} … {figure_text(max(known))}</small>"


def _erratum_row(erratum: Erratum) -> str:
    fails = '<span class="held no">fails</span>' if erratum.printed_fails else "does not fail"
    holds = '<span class="held yes">holds</span>' if erratum.right_holds else "does not hold"
    return (
        f"<tr><td>{escape(erratum.equation)}</td>"
        f"<td>{escape(erratum.printed)}<p>{figure_text(erratum.printed_error)} {fails}</p></td>"
        f"<td>{escape(erratum.right)}<p>{figure_text(erratum.right_error)} {holds}</p></td>"
        f"<td>{escape(erratum.measure)}<br><small>at most {figure_text(erratum.limit)}: "
        f"{escape(erratum.why)}</small></td></tr>"
    )


_PAGE: Final = Template(
    """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>The paper, rebuilt</title>
<style>
body { font: 15px/1.5 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; color: #222;
  max-width: 1120px; margin: 2rem auto; padding: 0 1.2rem; }
h1 { font-size: 1.7rem; margin-bottom: .2rem; } h2 { margin-top: 3rem; font-size: 1.25rem;
  border-bottom: 1px solid #ddd; padding-bottom: .3rem; } h3 { font-size: 1rem; margin: 0; }
p { max-width: 52rem; } small, .note { color: #666; } .note { font-size: .9rem; }
table { border-collapse: collapse; width: 100%; margin: .8rem 0; }
th { text-align: left; font-weight: 600; font-size: .85rem; color: #666; }
th, td { border-bottom: 1px solid #e6e6e6; padding: .4rem .7rem .4rem 0; vertical-align: top; }
td p { margin: .2rem 0 0; font-variant-numeric: tabular-nums; }
.num { white-space: nowrap; font-variant-numeric: tabular-nums; }
figure { margin: 1.6rem 0; } figcaption { font-size: .9rem; color: #444; max-width: 60rem;
  margin-bottom: .5rem; } img { max-width: 100%; }
ul.counts { list-style: none; padding: 0; display: flex; gap: 1rem; flex-wrap: wrap; }
ul.counts li { border-left: 4px solid; padding: .1rem .7rem; } ul.counts b { font-size: 1.3rem; }
.badge, .held { white-space: nowrap; font-size: .85rem; font-weight: 600; }
.yes { color: #00694b; } .no { color: #a83c00; } .misprint { color: #00598c; }
.claim { margin: 2rem 0; } code { font-size: .9em; } a { color: inherit; }
.parts { table-layout: fixed; } .parts th:nth-child(1) { width: 33%; }
.parts th:nth-child(2), .parts th:nth-child(3) { width: 14%; } .parts th:nth-child(5) { width: 9%; }
.errata td:nth-child(2), .errata td:nth-child(3) { width: 26%; }
</style>
</head>
<body>
<h1>The paper, rebuilt</h1>
<p>“Adaptive Identification and Application of Flow Mapping for Electrohydraulic Valves”: its
figures and tables from recordings of a virtual test rig, its thirteen claims, its open
point and its Figure 1 with a verdict each, and every misprint beside the right form. Nothing here
is typed in: figures are computed, and verdicts follow from them.</p>
<ul class="counts">
$counts
</ul>
<table>
<thead><tr><th>#<th>the paper's claim<th>verdict<th>in sets<th>at $faster Hz</tr></thead>
<tbody>
$summary
</tbody>
</table>
<p class="note">How a verdict comes about: each claim is split into figures, each with a limit on
one side of which the claim holds. All hold with the right formulas: <b>reproduced</b>. Those that
do not hold do so with the formulas as the paper misprints them: <b>explained by an erratum</b>.
Otherwise: <b>not reproduced</b>. There are $recordings; the median over the sets decides, and
“in sets” tells in how many of them, taken
alone, it is the same. The last column judges one more set of $faster samples a second: where it
differs, the claim hangs on how fast one samples, which the paper does not tell. The last claim is
judged on a cylinder of its own, once.</p>

<h2>The valve and the data</h2>
$figures

<h2>Tables 1 and 2</h2>
$tables

<h2>What is behind the verdicts</h2>
$runs

<h2>The claims, figure by figure</h2>
<p class="note">Error: root mean square over the points of Figure 9, in l/min. Unrest: the error
that 95 % of the last third of a run stay below, over its limit; a run converged if it is 1 at most.
A run settles when its error stays within √2 times its last one. Small print: lowest and highest
over the sets; ∞: never, or no finite number.</p>
$claims

<h2>Misprints</h2>
<p>$shown of $all_errata are shown by their figures: the printed form fails where the right one
holds.</p>
<table class="errata">
<thead><tr><th>equation<th>printed<th>right<th>what is measured</tr></thead>
<tbody>
$errata
</tbody>
</table>
<p class="note">Made by <code>valvemap report</code>; all numbers, those in the pictures too, are in
<code>paper.json</code> beside this page.</p>
</body>
</html>
"""
)
