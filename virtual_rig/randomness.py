"""Random numbers by address: sample i of a stream is the same in whatever blocks it is drawn.

Each stream is a counter-based generator (Philox) keyed by seed, owner and purpose, and drawn in
fixed chunks, so that nothing has to be remembered between blocks.
"""

import zlib
from collections.abc import Callable

import numpy as np

from virtual_rig.kernels import Floats

_CHUNK = 1024


def normal(seed: int, stream: str, start: int, n: int) -> Floats:
    """Standard normal numbers start … start + n - 1 of a stream.

    >>> whole = normal(1, "Valvistor.Q noise", 0, 3000)
    >>> bool((normal(1, "Valvistor.Q noise", 1000, 100) == whole[1000:1100]).all())
    True
    """
    return _draw(lambda generator: generator.standard_normal(_CHUNK), seed, stream, start, n)


def uniform(seed: int, stream: str, start: int, n: int) -> Floats:
    """Numbers start … start + n - 1 of a stream, uniform in [0, 1)."""
    return _draw(lambda generator: generator.random(_CHUNK), seed, stream, start, n)


def _draw(
    chunk_of: Callable[[np.random.Generator], Floats], seed: int, stream: str, start: int, n: int
) -> Floats:
    key = np.array([seed, zlib.crc32(stream.encode())], dtype=np.uint64)
    first, last = start // _CHUNK, (start + n - 1) // _CHUNK
    chunks = [
        chunk_of(np.random.Generator(np.random.Philox(key=key, counter=[0, 0, 0, chunk])))
        for chunk in range(first, last + 1)
    ]
    offset = start - first * _CHUNK
    return np.concatenate([np.empty(0), *chunks])[offset : offset + n]
