"""Mutants of valid inputs: bits, lengths, cuts, insertions, and the values of JSON."""

import json
import struct
from functools import lru_cache

HOSTILE = (
    *(None, True, "", "\ud800", "x" * 300, [], {}, [[]], "NaN"),
    *(0, -1, 2**31, 2**62, 2**63, 2**64, -(2**63) - 1, 10**400, 1e308, 5e-324),
    *(float("nan"), float("inf"), float("-inf")),
)
LENGTHS = (-1, -2, 0, 1, 2**15, 2**31 - 1, -(2**31), 1_000_000)
WORDS = (
    *(b"NaN", b"Infinity", b"-1e999", b"null", b'"\\ud800"', b"\xff\xfe", b"\x00", b"\n"),
    *(b"(" * 50, b"[" * 200, b"9" * 400, b'"', b",", b"'", b"-", b"\\u0000"),
)
_MOST = 60_000  # bytes of a mutant


def mutant(seed, others, dice):
    """Break an input in one to four places; half of the mutants of JSON are valid JSON."""
    if dice.random() < 0.5 and (said := _json(seed)) is not None:
        for _ in range(dice.randint(1, 3)):
            said = _altered(said, dice)
        return json.dumps(said).encode("utf-8", "surrogatepass")
    body = bytearray(seed)
    for _ in range(dice.randint(1, 4)):
        _break(body, others, dice)
    return bytes(body[:_MOST])


def _break(body, others, dice):
    edge = dice.choice((8, 100, len(body) + 1))  # headers are short, and matter most
    at = dice.randrange(min(edge, len(body) + 1))
    match dice.randrange(9):
        case 0 if at < len(body):
            body[at] ^= 1 << dice.randrange(8)
        case 1 if at < len(body):
            body[at] = dice.randrange(256)
        case 2:
            body[at : at + 4] = struct.pack("<i", dice.choice(LENGTHS))
        case 3:
            body[at : at + 8] = struct.pack("<q", dice.choice((-1, 0, 2**62, 2**63 - 1, -(2**63))))
        case 4:
            del body[at:]
        case 5:
            del body[at : at + dice.randint(1, 8)]
        case 6:
            body[at:at] = dice.choice((dice.choice(WORDS), dice.randbytes(dice.randint(1, 16))))
        case 7:
            body[at:at] = body[at : at + dice.randint(1, 64)] * dice.randint(1, 3)
        case 8:
            other = dice.choice(others)
            body[at:] = other[min(at, len(other)) :]


@lru_cache(maxsize=64)  # seeds are few, and no mutant changes what was read
def _json(seed):
    if seed[:1] not in (b"{", b"["):
        return None
    try:
        return json.loads(seed)
    except ValueError:
        return None


def _altered(said, dice):
    """Replace, drop or repeat one part of a value, wherever in it."""
    if not isinstance(said, dict | list) or not said or dice.random() < 0.2:
        return dice.choice(HOSTILE)
    said = said.copy()
    key = dice.choice(list(said)) if isinstance(said, dict) else dice.randrange(len(said))
    match dice.randrange(6):
        case 0:
            del said[key]
        case 1 if isinstance(said, list):
            said.append(said[key])
        case 1:
            said[str(dice.choice(HOSTILE))[:40]] = said[key]
        case _:
            said[key] = _altered(said[key], dice)
    return said
