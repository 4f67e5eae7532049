"""`replay` of a valve with ports: closed edges are no gaps, lines have no drop."""

import numpy as np
import pandas as pd

from valvemap.cli import run

CONFIG = """[[valves]]
name = "Boom"
ports = { U = "s=U", pP = "s=pP", pT = "s=pT", pA = "s=pA", QA = "s=QA" }
estimators = [{ kind = "RLS" }]
"""


def test_closed_edges_are_no_gaps_and_lines_have_no_drop(tmp_path, capsys):
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 40.0, 0.02)
    U = 80 * np.sign(np.sin(t)) * rng.uniform(0.5, 1.0, len(t))
    pA = rng.uniform(40, 160, len(t))
    Q = 0.1 * U * np.sqrt(np.where(U > 0, 200 - pA, pA - 5)) + 0.1 * rng.normal(size=len(t))
    rows = {"t": t, "U": U, "pP": 200 + 0 * t, "pT": 5 + 0 * t, "pA": pA, "QA": Q}
    pd.DataFrame(rows).drop(range(500, 600)).to_csv(tmp_path / "r.csv", index=False)
    (tmp_path / "boom.toml").write_text(CONFIG)
    assert run(["replay", str(tmp_path / "r.csv"), "--config", str(tmp_path / "boom.toml")]) == 0
    said = capsys.readouterr().out
    gaps = [line for line in said.splitlines() if "gaps:" in line]
    assert [line.partition(":")[0] for line in gaps] == ["Boom.LineA"]
    assert "Boom.PA: recommended" in said
    assert "Boom.LineA: recommended" not in said
    assert "Boom.LineA: hint" not in said
