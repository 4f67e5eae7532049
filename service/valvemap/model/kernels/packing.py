"""Compression of the compiled kernels for a wheel, called at its build."""

import lzma
import pickle
from pathlib import Path
from typing import Final

from valvemap.model.kernels.ahead import BITCODES
from valvemap.model.kernels.numba_libraries import packed

_ANNOTATION: Final = 6  # index of a text in numba's reduced result: the source with its types


def pack(folder: Path) -> int:
    """Remove parts that only a compiler needs, compress the rest; return the number of kernels."""
    bitcodes: dict[bytes, bytes] = {}
    left = 0
    for file in sorted(folder.rglob("*.nbc")):
        library, *rest = pickle.loads(file.read_bytes())  # noqa: S301 - this build wrote it
        small = packed(library, bitcodes)
        if small is None:
            file.unlink()
            file.with_name(f"{file.name.rsplit('.', 2)[0]}.nbi").unlink(missing_ok=True)
        else:
            rest[_ANNOTATION - 1] = ""
            file.write_bytes(pickle.dumps((small, *rest), protocol=-1))
            left += 1
    (folder / BITCODES).write_bytes(lzma.compress(pickle.dumps(bitcodes, protocol=-1)))
    return left
