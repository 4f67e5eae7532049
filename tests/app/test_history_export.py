"""What was kept of signals, as a recording."""

import numpy as np
import pytest

from valvemap.cli import run
from valvemap.model.samples import Samples, Segments
from valvemap.pipeline.by_valve import ByValve
from valvemap.runtime.past import PastKeeper
from valvemap.storage.history import HistoryFile
from valvemap.storage.recordings import read_recording

N, START = 5_000, 1_700_000_000_000_000_000


def samples():
    rng = np.random.default_rng(4)
    U, p1, p2, Q, T = rng.normal(size=(5, N))
    return Samples.of(START + 10_000_000 * np.arange(N), U, p1, p2, Q, T, np.arange(N) % 3)


@pytest.fixture
async def config(tmp_path):
    with HistoryFile(tmp_path / "history.sqlite") as store:
        keeper = PastKeeper(store, ["V1", "V2"])
        for first in range(0, N, 700):
            part = samples()[first : first + 700]
            keeper.take(ByValve(part, Segments.one(len(part))))
            await keeper.settle()
    file = tmp_path / "service.toml"
    file.write_text(
        f'[history]\nfile = "{tmp_path / "history.sqlite"}"\n'
        '[[valves]]\nname = "V1"\n[[valves]]\nname = "V2"\n'
    )
    return file


def export(config, *arguments):
    return run(["history", "export", *map(str, arguments), "--config", str(config)])


def recorded(file):
    ((valve, first), *rest) = read_recording(file)
    parts = [first, *(part for _, part in rest)]
    return valve, {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("t", "U", "p1", "p2", "Q", "T", "quality")
    }


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_every_sample_is_in_the_recording_to_the_bit(config, tmp_path, ending):
    file = tmp_path / f"out.{ending}"
    assert export(config, file) == 0
    valve, columns = recorded(file)
    assert valve == "V1"
    for name, column in columns.items():
        np.testing.assert_array_equal(column, getattr(samples(), name))


def test_a_span_is_what_was_asked_for(config, tmp_path, capsys):
    file = tmp_path / "out.csv"
    first, last = START + 10 * 10_000_000, START + 19 * 10_000_000
    assert export(config, file, "--from", first, "--to", last) == 0
    assert recorded(file)[1]["t"].tolist() == samples().t[10:20].tolist()
    assert "10 samples" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("out.csv", "--valve", "V9"), 2, "valve 'V9': there are V1, V2"),
        (("out.csv", "--valve", "V2"), 1, "nothing is known of that span"),
        (("out.csv", "--from", "yesterday"), 2, "--from yesterday"),
        (("out.doc",), 2, "out.doc"),
    ],
)
def test_what_cannot_be_exported_is_said_in_one_line(
    config, tmp_path, capsys, arguments, code, said
):
    out, *rest = arguments
    assert export(config, tmp_path / out, *rest) == code
    error = capsys.readouterr().err
    assert said in error
    assert "Traceback" not in error


def test_without_a_history_its_setting_is_named(tmp_path, capsys):
    file = tmp_path / "service.toml"
    file.write_text('[[valves]]\nname = "V1"\n')
    assert export(file, tmp_path / "out.csv") == 2
    assert "history.file is not set" in capsys.readouterr().err
