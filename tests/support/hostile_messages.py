"""Messages that a fleet must survive: the rows of a review, and mutants of honest messages."""

import io
import json

import numpy as np
import pyarrow as pa

from valvemap.kafka.commands import is_reply

FAR = 4_607_000_000_000_000_000  # a day of 2115
COMMAND = {
    "valvemap": "command",
    "version": 1,
    "id": "hostile",
    "group": "north.0",
    "valve": "V0",
    "action": "demand",
    "estimator": "",
    "values": [1.0, 2.0],
}
REPLY = {
    "valvemap": "reply",
    "version": 1,
    "id": "hostile",
    "group": "north.0",
    "number": 1,
    "done": True,
    "reason": "",
    "values": [],
}
NO_NUMBERS = (
    *(float("inf"), float("-inf"), float("nan"), 10**400, -(10**400), "", "NaN", "\ud800"),
    *([], [[]] * 50, {}, {"a": []}, True, False, "x" * 100_000, [0] * 100_000),
)
VALUES = (
    *NO_NUMBERS,
    *(2**62, 2**63, 2**64, -1, 0, 1e308, 1e-300, None, -0.0, 255, 1.5),
)


def opened(block):
    """The schema's metadata and the columns of a block."""
    with pa.ipc.open_stream(block) as stream:
        (batch,) = list(stream)
        return dict(stream.schema.metadata), dict(
            zip(batch.schema.names, batch.columns, strict=True)
        )


def closed(metadata, columns, compression="lz4"):
    """A block of any columns."""
    n = {len(column) for column in columns.values()}
    n = min(n) if n else 0
    columns = {name: column[:n] for name, column in columns.items()}
    schema = pa.schema([(name, one.type) for name, one in columns.items()], metadata)
    sink = io.BytesIO()
    options = pa.ipc.IpcWriteOptions(compression=compression)
    with pa.ipc.new_stream(sink, schema, options=options) as stream:
        stream.write_batch(pa.RecordBatch.from_arrays(list(columns.values()), schema=schema))
    return sink.getvalue()


def with_metadata(block, compression="lz4", **said):
    metadata, columns = opened(block)
    metadata |= {f"valvemap.{name}".encode(): json.dumps(one) for name, one in said.items()}
    return closed(metadata, columns, compression)


def with_columns(block, **new):
    metadata, columns = opened(block)
    return closed(metadata, columns | {n.replace("__", "."): one for n, one in new.items()})


def bomb(block, rows=4_000_000, compression="lz4"):
    """A block of many rows, all alike."""
    metadata, columns = opened(block)
    index = pa.array(np.zeros(rows, np.int64))
    return closed(metadata, {n: c.take(index) for n, c in columns.items()}, compression)


def at_once(block, t):
    """The same samples, all at one time."""
    _, columns = opened(block)
    times = pa.array(np.full(len(columns["t"]), t), pa.int64()).cast(columns["t"].type)
    return with_columns(block, t=times)


def commands():
    """By name: commands that cannot be."""
    for name, value in enumerate(NO_NUMBERS):
        yield f"values {name}", said(COMMAND, values=[value, 1.0])
    for field in ("id", "group", "valve", "estimator", "comment", "by", "action"):
        yield f"{field}: surrogate", said(COMMAND, **{field: "\ud800"})
        yield f"{field}: long", said(COMMAND, **{field: "x" * 1_000_000})
    yield "no JSON", b"\x00\xff"
    yield "1e999", json.dumps(COMMAND).replace("1.0", "1e999").encode()
    yield "deep", b"[" * 100_000
    yield "empty", b""
    yield (
        "acknowledged at 1e308",
        said(COMMAND, action="acknowledge", estimator="Changed", values=[1e308]),
    )


def blocks(block):
    """By name: blocks of samples that cannot be."""
    yield "catalogue", with_metadata(block, catalogue=2**62)
    yield "number", with_metadata(block, number=10**400)
    yield "4 million rows, lz4", bomb(block)
    yield "4 million rows, zstd", bomb(block, compression="zstd")
    yield "zstd", with_metadata(block, "zstd")
    yield "2116", at_once(block, FAR)
    yield "1678", at_once(block, -(2**63) + 1)
    yield "no block", b"\xff\xff\xff\xff"
    yield "empty", b""


def results(block):
    """By name: results that cannot be shown."""
    _, columns = opened(block)
    n = len(columns["valve"])
    yield "empty theta", with_columns(block, RLS__theta=pa.array([[]] * n, pa.list_(pa.float64())))
    for name in ("RLS.quality", "signals.quality", "inverse.status", "RLS.status"):
        codes = pa.array([255] * n, pa.uint8())
        yield f"{name} 255", with_columns(block, **{name.replace(".", "__"): codes})
    yield "shape", with_metadata(block, map_shape=[10**9, 10**9])
    yield "estimators", with_metadata(block, estimators=["RLS", 5])
    yield "no estimators", with_metadata(block, estimators=[])
    yield "id: []", said(REPLY, id=[])
    yield "id: {}", said(REPLY, id={})
    yield "values", said(REPLY, values=[[]])
    yield "rows", bomb(block, 10_000)
    yield "empty", b""


def said(message, **fields):
    return json.dumps(message | fields).encode()


def mutant(message, dice):
    """A message that differs from an honest one: in a byte, a field, a column or its length."""
    kind = dice.integers(6)
    if kind == 0:
        return damaged(message, dice)
    if kind == 1:
        return message[: dice.integers(len(message) + 1)]
    if is_reply(message):
        return _json_mutant(message, dice)
    try:
        return _block_mutant(message, dice)
    except (pa.ArrowException, ValueError, TypeError, NotImplementedError, UnicodeError):
        return damaged(message, dice)


def damaged(message, dice):
    found = bytearray(message)
    for _ in range(dice.integers(1, 5)):
        at = int(dice.integers(len(found)))
        match dice.integers(4):
            case 0:
                found[at] = dice.integers(256)
            case 1:
                found[at : at + 8] = int(dice.choice([-1, 0, 2**31, 2**62])).to_bytes(
                    8, "little", signed=True
                )
            case 2:
                del found[at : at + int(dice.integers(1, 9))]
            case 3:
                found[at:at] = dice.bytes(int(dice.integers(1, 9)))
        if not found:
            break
    return bytes(found)


def _json_mutant(message, dice):
    found = json.loads(message)
    for _ in range(dice.integers(1, 4)):
        name = str(dice.choice([*found, "more"]))
        value = VALUES[dice.integers(len(VALUES))]
        if name == "values" and dice.random() < 0.7:
            value = [value] * int(dice.integers(4))
        if dice.random() < 0.1:
            found.pop(name, None)
        else:
            found[name] = value
    return json.dumps(found).encode()


def _block_mutant(message, dice):
    metadata, columns = opened(message)
    for _ in range(dice.integers(1, 3)):
        if dice.random() < 0.3:
            key = str(dice.choice([one.decode() for one in metadata]))
            metadata[key.encode()] = json.dumps(VALUES[dice.integers(len(VALUES))]).encode()
            continue
        name = str(dice.choice(list(columns)))
        columns[name] = _column_mutant(columns, name, dice)
    return closed(metadata, columns, str(dice.choice(["lz4", "lz4", "zstd"])))


def _column_mutant(columns, name, dice):
    one, n = columns[name], len(columns[name])
    match dice.integers(4):
        case 0:  # another's, under its name
            return columns[str(dice.choice(list(columns)))]
        case 1:
            return pa.nulls(n, one.type)
        case 2:
            return one.take(pa.array(dice.integers(0, max(n, 1), n)))
    return pa.array(
        _values_of(one.type, n, dice), pa.int64() if pa.types.is_timestamp(one.type) else one.type
    ).cast(one.type)


def _values_of(kind, n, dice):
    """Values of a type that an honest sender never sends."""
    for is_so, values in _OF_KIND:
        if is_so(kind):
            return dice.choice(values, n)
    if pa.types.is_list(kind):
        return [[] if dice.random() < 0.5 else None] * n
    if pa.types.is_string(kind):
        return [str(dice.choice(["", "V0", "x" * 10_000, "V\x1b[0m"]))] * n
    return [None] * n


_OF_KIND = (
    (pa.types.is_timestamp, [FAR, -(2**63) + 1, 2**63 - 1, 0]),
    (pa.types.is_uint8, np.arange(256, dtype=np.uint8)),
    (pa.types.is_floating, [np.nan, np.inf, -np.inf, 1e308, -1e308, 1e-300, 0.0]),
    (pa.types.is_int64, [-(2**63), -1, 2**62, 2**63 - 1]),
)
