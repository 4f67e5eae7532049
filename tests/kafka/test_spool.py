"""What waits for the broker waits on disk, in order, and no more of it than is allowed."""

import pytest

pytest.importorskip("pyarrow")

from valvemap.errors import StorageError
from valvemap.kafka.spool import GivenUp, Packed, Spool


def block(number, size=100):
    return Packed("north.0", number, 10, bytes([number]) * size)


def data(waiting):
    return [one.data[0] for one in waiting]


def test_what_was_not_noted_as_sent_is_there_after_a_restart_in_its_order(tmp_path):
    path = tmp_path / "a" / "north.sqlite"
    with Spool(path, 10_000) as spool:
        spool.save([block(1), block(2)], {"position": b"2"})
        spool.save([block(3)], {"position": b"3"})
        first, second = spool.take(200)
        assert data(spool.take(200)) == [3]
        spool.note_sent([second.id])
        spool.take_again()
        assert data(spool.take(10_000)) == [1, 3]
    with Spool(path, 10_000) as spool:
        assert (spool.blocks, spool.bytes) == (2, 200)
        assert spool.kept() == {"position": b"3"}
        assert data(spool.take(10_000)) == [1, 3]
        spool.note_sent([first.id, first.id])
        assert (spool.blocks, spool.bytes) == (1, 100)


def test_the_oldest_that_are_not_under_way_make_room_and_are_counted(tmp_path):
    with Spool(tmp_path / "s.sqlite", 300) as spool:
        assert spool.save([block(k) for k in (1, 2, 3)], {}) == GivenUp(0, 0)
        assert data(spool.take(100)) == [1]
        assert spool.save([block(4), block(5)], {}) == GivenUp(2, 20)
        assert data(spool.take(1_000)) == [4, 5]
        assert (spool.blocks, spool.bytes) == (3, 300)
        assert spool.save([block(6)], {}) == GivenUp(1, 10)  # all else is under way


def test_a_full_disk_is_one_line_and_changes_nothing(tmp_path):
    with Spool(tmp_path / "s.sqlite", 10_000_000) as spool:
        spool.save([block(1)], {"position": b"1"})
        pages = spool._connection.execute("PRAGMA page_count").fetchone()[0]
        spool._connection.execute(f"PRAGMA max_page_count = {pages}")
        with pytest.raises(StorageError, match=r"s\.sqlite cannot be used: .*full"):
            spool.save([block(2, 1_000_000)], {"position": b"2"})
        assert (spool.blocks, spool.bytes) == (1, 100)
        assert spool.kept() == {"position": b"1"}
        spool._connection.execute(f"PRAGMA max_page_count = {1_000_000}")
        spool.save([block(2, 1_000_000)], {"position": b"2"})
        assert data(spool.take(10_000_000)) == [1, 2]


def test_a_second_collector_of_a_site_is_turned_away(tmp_path):
    with (
        Spool(tmp_path / "s.sqlite", 100),
        pytest.raises(StorageError, match=r"s\.sqlite cannot be used: database is locked"),
    ):
        Spool(tmp_path / "s.sqlite", 100)


def test_a_file_of_another_program_is_left_alone(tmp_path):
    (tmp_path / "s.sqlite").write_text("not ours" * 100)
    with pytest.raises(StorageError, match=r"s\.sqlite"):
        Spool(tmp_path / "s.sqlite", 100)
