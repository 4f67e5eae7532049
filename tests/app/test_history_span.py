"""The start and `check-config` say how long the history's size lasts."""

import pytest

from valvemap.app.history_span import span_in_words
from valvemap.cli import run
from valvemap.config.models import Config


def config(valves, **history):
    given = {"file": "history.sqlite", **history}
    names = [{"name": f"V{k}"} for k in range(valves)]
    return Config.model_validate({"history": given, "valves": names})


@pytest.mark.parametrize(
    ("one", "measured", "words"),
    [
        (config(1), 0.0, "signals for 7 days, results for 7 days, summaries of 10 s for 7 days"),
        (config(20), 0.0, "signals for 7 days, results for 0."),
        (config(20), 0.0, "of 5 min for 30 days, at one sample per publishing interval: most_mb"),
        (config(20), 1_000.0, "results for 7 days, summaries of 10 s for 7 days, of 5 min for 30"),
        (config(20), 1_000.0, "days, as measured"),
        (config(1, results_days=2.0), 0.0, "signals for 7 days, results for 2 days, summaries"),
        (config(20, most_mb=100, keep_days=2.0), 1e4, "as measured: most_mb deletes the oldest"),
    ],
)
def test_it_is_estimated_until_it_is_measured(one, measured, words):
    assert words in span_in_words(one, measured)


def test_check_config_says_it(tmp_path, capsys):
    file = tmp_path / "valvemap.toml"
    file.write_text('[history]\nfile = "history.sqlite"\n[[valves]]\nname = "V1"\n')
    assert run(["check-config", str(file)]) == 0
    line = next(x for x in capsys.readouterr().out.splitlines() if x.startswith("history"))
    assert "2,000 MB hold signals for 7 days" in line
