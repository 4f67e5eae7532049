"""The frames that a peer has sent: received bytes are split into them."""

from collections import deque
from typing import Final

HELLO, OPEN, MESSAGE, CLOSE = b"HEL", b"OPN", b"MSG", b"CLO"

_CHUNK_KINDS: Final = b"FCA"
_HELLO_BYTES: Final = 8 + 20 + 4 + 4_096
_OPEN_BYTES: Final = 24 * 1024
_CLOSE_BYTES: Final = 1_024
_FRAMES_AHEAD, _BYTES_AHEAD = 32, 128 * 1024


class Frames:
    """Whole frames that wait to be read, and the beginning of the next one.

    Examples
    --------
    >>> frames = Frames()
    >>> frames.add(b"CLOF" + bytes([12, 0, 0, 0]) + b"1234CLO", message_bytes=8_192)
    True
    >>> len(frames), frames.next_size, frames.take()[8:]
    (1, 12, b'1234')
    >>> frames.add(b"?", message_bytes=8_192), frames.add(b"1234", message_bytes=8_192)
    (True, False)
    """

    def __init__(self) -> None:
        self._whole: deque[bytes] = deque()
        self._rest = bytearray()

    def add(self, data: bytes | memoryview, message_bytes: int) -> bool:
        """Split received bytes; return False if they are no OPC UA, or too large a frame."""
        self._rest += data
        while len(self._rest) >= 8:
            size = int.from_bytes(self._rest[4:8], "little")
            if not _plausible(bytes(self._rest[:4]), size, message_bytes):
                return False
            if len(self._rest) < size:
                break
            self._whole.append(bytes(self._rest[:size]))
            del self._rest[:size]
        return True

    def take(self) -> bytes:
        """Return and remove the oldest frame."""
        return self._whole.popleft()

    def clear(self) -> None:
        """Remove everything."""
        self._whole.clear()
        self._rest.clear()

    @property
    def next_size(self) -> int:
        """Size of the oldest frame, bytes."""
        return len(self._whole[0])

    @property
    def are_many(self) -> bool:
        """Whether more wait than are read ahead."""
        return len(self._whole) > _FRAMES_AHEAD or sum(map(len, self._whole)) > _BYTES_AHEAD

    def __len__(self) -> int:
        return len(self._whole)


def _plausible(kind: bytes, size: int, message_bytes: int) -> bool:
    most = {
        HELLO: _HELLO_BYTES,
        OPEN: _OPEN_BYTES,
        CLOSE: _CLOSE_BYTES,
        MESSAGE: message_bytes,
    }.get(kind[:3], 0)
    whole = kind[:3] == MESSAGE or kind[3:] == b"F"
    return 8 < size <= most and kind[3] in _CHUNK_KINDS and whole
