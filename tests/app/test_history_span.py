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
        (config(1), 0.0, "last about 11 days at one sample per publishing interval; keep_days = 7"),
        (config(20), 0.0, "0.54 days at one sample per publishing interval; keep_days = 7: the"),
        (config(20), 1_000.0, "2,000 MB last about 23 days as measured; keep_days = 7"),
        (config(20, most_mb=100, keep_days=2.0), 1e4, "0.12 days as measured; keep_days = 2: the"),
    ],
)
def test_it_is_estimated_until_it_is_measured(one, measured, words):
    assert words in span_in_words(one, measured)


def test_check_config_says_it(tmp_path, capsys):
    file = tmp_path / "valvemap.toml"
    file.write_text('[history]\nfile = "history.sqlite"\n[[valves]]\nname = "V1"\n')
    assert run(["check-config", str(file)]) == 0
    line = next(x for x in capsys.readouterr().out.splitlines() if x.startswith("history"))
    assert "2,000 MB last about 11 days" in line
