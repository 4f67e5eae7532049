"""A stream is within its limits, or it is refused before anything of it is decompressed."""

import re
import time
import tracemalloc

import numpy as np
import pytest

pytest.importorskip("pyarrow")

import pyarrow as pa

from support import hostile_messages as hostile
from support.fleet import block, catalogue
from valvemap.errors import BlockError
from valvemap.kafka.blocks import write_samples
from valvemap.kafka.envelope import Limits, check

LIMITS = Limits(packed=1_000_000, rows=60, unpacked=100_000, names=3)


@pytest.fixture(scope="module")
def honest():
    return write_samples(block(catalogue().groups["north.0"], 1, (20, 20, 20)))


def stream(columns, *, batches=1, **options):
    schema = pa.schema([(name, one.type) for name, one in columns.items()])
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, schema, options=pa.ipc.IpcWriteOptions(**options)) as out:
        for _ in range(batches):
            out.write_batch(pa.RecordBatch.from_arrays(list(columns.values()), schema=schema))
    return sink.getvalue().to_pybytes()


def test_an_honest_block_is_within_its_own_limits_and_not_in_smaller_ones(honest):
    check(honest, LIMITS)
    for change, said in (
        ({"packed": len(honest) - 1}, "bytes: at most"),
        ({"rows": 59}, "60 rows: at most 59"),
        ({"names": 2}, "3 rows: at most 2"),
        ({"unpacked": 60 * 53}, "once it is decompressed"),
    ):
        with pytest.raises(BlockError, match=said):
            check(honest, Limits(**{**vars(LIMITS), **change}))


def test_a_foreign_writers_block_that_is_not_compressed_is_within_its_limits():
    check(stream({"x": pa.array(np.zeros(60))}), LIMITS)


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (stream({"x": pa.array(np.zeros(60))}, compression="zstd"), "another codec than LZ4"),
        (stream({"x": pa.array(np.zeros(60))}, batches=9), "messages in a stream"),
        (stream({"x": pa.nulls(61)}), "61 rows: at most 60"),
        (stream({"x": pa.array([[0.0] * 20_000])}, compression="lz4"), "once it is decompressed"),
        (b"\xff" * 100, "not an Arrow IPC stream"),
    ],
)
def test_what_is_beyond_the_limits_is_refused(message, said):
    with pytest.raises(BlockError, match=re.escape(said)):
        check(message, LIMITS)


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
def test_four_million_rows_are_refused_without_being_decompressed(honest, compression):
    bomb = hostile.bomb(honest, 4_000_000, compression)
    assert len(bomb) < 1_000_000
    tracemalloc.start()
    arrow, began = pa.total_allocated_bytes(), time.process_time()
    with pytest.raises(BlockError):
        check(bomb, LIMITS)
    assert time.process_time() - began < 0.1
    assert pa.total_allocated_bytes() == arrow
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    tracemalloc.stop()


def test_sizes_and_places_that_lie_are_refused_whatever_they_say(honest):
    """Every 8 bytes of a block, set to what a size can be: refused in one line, or read."""
    refused = []
    for at in range(0, len(honest) - 8, 4):
        for lie in (-2, 2**31, 2**62, -(2**63)):
            damaged = bytearray(honest)
            damaged[at : at + 8] = lie.to_bytes(8, "little", signed=True)
            try:
                check(bytes(damaged), LIMITS)
            except BlockError as error:
                refused.append(str(error))
    assert len(refused) > 300
    assert [said for said in refused if len(said.splitlines()) != 1] == []
