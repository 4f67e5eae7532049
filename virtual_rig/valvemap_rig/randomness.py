"""Random access to random numbers: number i of a stream does not depend on the block size.

Each stream is a counter-based generator (Philox) keyed by seed, owner and purpose, and drawn in
fixed chunks, so that no state is kept between blocks.
"""

import zlib
from functools import lru_cache
from typing import Literal, assert_never

import numpy as np

from valvemap_rig.records import Floats

_CHUNK = 1024


def normal(seed: int, stream: str, start: int, n: int) -> Floats:
    """Return standard normal numbers start … start + n - 1 of a stream.

    >>> whole = normal(1, "Valvistor.Q noise", 0, 3000)
    >>> bool((normal(1, "Valvistor.Q noise", 1000, 100) == whole[1000:1100]).all())
    True
    """
    return _draw("normal", seed, stream, start, n)


def uniform(seed: int, stream: str, start: int, n: int) -> Floats:
    """Return numbers start … start + n - 1 of a stream, uniform in [0, 1)."""
    return _draw("uniform", seed, stream, start, n)


def _draw(
    distribution: Literal["normal", "uniform"], seed: int, stream: str, start: int, n: int
) -> Floats:
    first, last = start // _CHUNK, (start + n - 1) // _CHUNK
    chunks = [_chunk(distribution, seed, stream, number) for number in range(first, last + 1)]
    offset = start - first * _CHUNK
    return np.concatenate([np.empty(0), *chunks])[offset : offset + n]


@lru_cache(maxsize=512)
def _chunk(
    distribution: Literal["normal", "uniform"], seed: int, stream: str, number: int
) -> Floats:
    key = np.array([seed, zlib.crc32(stream.encode())], dtype=np.uint64)
    generator = np.random.Generator(np.random.Philox(key=key, counter=[0, 0, 0, number]))
    match distribution:
        case "normal":
            chunk = generator.standard_normal(_CHUNK)
        case "uniform":
            chunk = generator.random(_CHUNK)
        case _:
            assert_never(distribution)
    chunk.setflags(write=False)
    return chunk
