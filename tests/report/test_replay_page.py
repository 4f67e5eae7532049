"""A replay as one page: everything in it, nothing from elsewhere."""

import re

import pytest
from rich.table import Table

from valvemap.errors import StorageError
from valvemap.report.replay_page import write_page

PNG = b"\x89PNG\r\n\x1a\n"


def a_table():
    table = Table(title="One step <ahead>")
    table.add_column("Valve")
    table.add_column("RMSE\nl/min", justify="right")
    table.add_row("V&1", "0.25")
    return table


def written(folder, *pictures):
    for name in pictures:
        (folder / name).write_bytes(PNG + name.encode())
    files = [folder / name for name in pictures]
    return write_page(folder, "Replay of a<b.csv", [a_table()], ["V&1: hint"], files)


def test_tables_notes_and_pictures_stand_in_the_page_itself(tmp_path):
    page = written(tmp_path, "V1-agreement.png", "V1-map-RLS.png")
    assert page == tmp_path / "index.html"
    for picture in tmp_path.glob("*.png"):
        picture.unlink()
    text = page.read_text(encoding="utf-8")
    assert text.count("data:image/png;base64,") == 2
    assert re.findall(r"(?:src|href)=\"(?!data:)", text) == []
    assert "<td class=number>0.25</td>" in text
    assert "V1, RLS. The map" in text


def test_names_from_recordings_are_no_markup(tmp_path):
    text = written(tmp_path).read_text(encoding="utf-8")
    for said in (
        "Replay of a&lt;b.csv",
        "One step &lt;ahead&gt;",
        "<td>V&amp;1</td>",
        "V&amp;1: hint",
    ):
        assert said in text


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(StorageError, match="file"):
        write_page(tmp_path / "file", "t", [], [], [])
