"""The notebooks run from their first cell to their last, and draw what they announce."""

import re
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "docs" / "notebooks"
NOTEBOOKS = {"csv_to_inverse": 1, "paper_tables": 2, "two_months": 1}  # pictures

pytestmark = pytest.mark.notebooks


@pytest.fixture(scope="module")
def executed(tmp_path_factory):
    """A notebook's outputs by MIME type, executed once."""
    import nbformat
    from nbclient import NotebookClient

    known = {}

    def run(name):
        if name not in known:
            notebook = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
            folder = tmp_path_factory.mktemp(name)
            NotebookClient(
                notebook, timeout=900, resources={"metadata": {"path": str(folder)}}
            ).execute()
            (folder / "executed.ipynb").write_text(nbformat.writes(notebook), encoding="utf-8")
            known[name] = [out for cell in notebook.cells for out in cell.get("outputs", ())]
        return known[name]

    return run


def texts(outputs):
    shown = [out.get("data", {}).get("text/plain", out.get("text", "")) for out in outputs]
    return "\n".join(shown)


def test_every_notebook_is_run():
    assert {file.stem for file in FOLDER.glob("*.ipynb")} == set(NOTEBOOKS)


@pytest.mark.timeout(1200)
@pytest.mark.parametrize("name", NOTEBOOKS)
@pytest.mark.filterwarnings("ignore")
def test_a_notebook_runs_and_draws(executed, name):
    outputs = executed(name)
    pictures = [out for out in outputs if "image/png" in out.get("data", {})]
    assert len(pictures) >= NOTEBOOKS[name]
    assert not [out for out in outputs if out.get("name") == "stderr"]


@pytest.mark.filterwarnings("ignore")
def test_the_csv_becomes_an_inverse(executed):
    shown = texts(executed("csv_to_inverse"))
    assert float(re.search(r"r2=([\d.]+)", shown)[1]) > 0.98
    assert "(certified)" in shown  # of Auto


@pytest.mark.filterwarnings("ignore")
def test_two_months_show_the_dead_band_and_the_gain(executed):
    shown = texts(executed("two_months"))
    row = r"2026-\d\d-\d\d +([-\d.]+) +([\d.]+) +([\d.]+) +([\d.]+)$"
    rows = re.findall(row, shown, re.MULTILINE)
    small, large = ([float(row[k]) for row in rows] for k in (2, 3))
    assert len(rows) == 9
    assert 1.5 < small[0] - small[-1] < 4.0
    assert 1.5 < large[5] - large[4] < 4.0
