"""`Auto` on plants drawn at random: ``python -m benchmarks.unseen_plants [--first S] [--seeds N]``.

A seed draws a valve, a working cycle, a sample rate and up to three circumstances; none is a row of
`benchmarks.one_model`. A line per plant and moment: RMSE of the map in σ at places that were
visited, the share of true flows inside the 95 % interval there and the least such share of a
quarter of U or Δp, the share of answers at status OK that are more than 3 σ off, sudden changes,
findings. σ is the root mean square of the meter's error without its offset and dead time. The last
line sums up the last moment of all plants; a change is false where no offset jumps. ``--only
WORD``: of these seeds the plants in whose description the word is.
"""

import argparse
import sys
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from benchmarks import circumstances as c
from benchmarks.drawn_plants import drawn
from benchmarks.one_model import answers, quarters
from benchmarks.one_model_rows import Row
from valvemap.model.fleet import alone
from valvemap.model.flow_map import FlowMap
from valvemap.vocabulary.findings import FindingCode

OFFSETS: Final = {FindingCode.FLOW_ZERO, FindingCode.PRESSURE_ZERO}
LINE: Final = (
    "{rmse:.2f} σ, held {held:.3f} (a quarter {least:.2f}), std {std:.2f} σ, "
    "answered {answered:.2f}, wrong {wrong:.3f}, changes {changes}"
)
BOX: Final = 2.5, 5.0  # %, bar; a place of at least three samples was visited


def visited(row: Row, end: int) -> c.Region:
    """Mean places of the boxes in which at least three of the first ``end`` samples lie."""
    U, dp = row.samples.U[:end], row.samples.dp[:end]
    box = np.floor(U / BOX[0]) * 1000 + np.floor(dp / BOX[1])
    _, which, many = np.unique(box, return_inverse=True, return_counts=True)
    means = [np.bincount(which, x) / many for x in (U, dp)]
    return c.Region(*(x[many >= 3] for x in means))


def judged(row: Row) -> list[dict[str, Any]]:
    """Figures at each moment."""
    found, start = [], 0
    estimator = FlowMap(U_range=row.U_range, dp_range=row.dp_range)
    state = estimator.initial_state()
    for end, truth in zip(row.ends, row.truths, strict=True):
        state, _ = estimator.update(state, row.samples[start:end])
        start, at = end, visited(row, end)
        Q, std = estimator.predict(state, at.U, at.dp, np.full(len(at.U), row.T))
        off = Q - truth(at.U, at.dp)
        held = np.abs(off) <= c.TWO_SIDED_95 * std
        answered, wrong = answers(estimator, state, row, truth, at)
        one = {"rmse": c.rms(off) / row.sigma, "std": c.rms(std) / row.sigma, "held": held.mean()}
        one |= {"least": min(held[q].mean() for x in (at.U, at.dp) for q in quarters(x))}
        one |= {"answered": answered, "wrong": wrong, "causes": row.causes}
        one |= {"changes": int(estimator.change_counts(alone(state))[0])}
        found.append(one | {"found": {finding.code for finding in estimator.findings(state)}})
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", default="")
    wanted = parser.parse_args(arguments)
    last = []
    for seed in range(wanted.first, wanted.first + wanted.seeds):
        row, words = drawn(seed)
        if wanted.only not in words:
            continue
        print(words)
        figures = judged(row)
        for end, one in zip(row.ends, figures, strict=True):
            names = ", ".join(sorted(code.label for code in one["found"])) or "-"
            print(f"  {end}: {LINE.format(**one)}, {names}", flush=True)
        last.append(figures[-1])
    print(_summary(last))
    return 0


def _summary(last: Sequence[dict[str, Any]]) -> str:
    rmse, held, wrong, answered = (
        np.array([one[key] for one in last]) for key in ("rmse", "held", "wrong", "answered")
    )
    changed = np.mean([one["changes"] > 0 for one in last if not one["causes"] & OFFSETS] or [0.0])
    misnamed = np.mean([bool(one["found"] - one["causes"]) for one in last])
    named = np.mean([one["causes"] <= one["found"] for one in last if one["causes"]] or [1.0])
    return (
        f"{len(last)} plants: median {np.median(rmse):.2f} σ, at most .8 in "
        f"{(rmse <= 0.8).mean():.2f}; held {held.mean():.3f}, below .9 in "
        f"{(held < 0.9).mean():.2f}; answered {answered.mean():.3f}, wrong {wrong.mean():.4f}, any "
        f"wrong in {(wrong > 0).mean():.2f}; a false change in {changed:.2f}, a false name in "
        f"{misnamed:.2f}, all named in {named:.2f}"
    )


if __name__ == "__main__":
    sys.exit(main())
