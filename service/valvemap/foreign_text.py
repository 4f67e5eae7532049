"""Text of others on its way out: names, units and errors of a server, a broker or a file.

Whatever they hold, a terminal obeys none of it, a log line stays one line, and TOML that is written
with it loads. Every such text leaves by one of these functions. The guarded server escapes its logs
by the same rule (`guarded_opcua.logs`), because it stands alone.
"""

import unicodedata
from typing import Final

MOST: Final = 200  # characters; of a name, an ellipsis stands for the rest
LINE: Final = 4_000  # characters; of a line of log or terminal
_MARKS: Final = 3  # combining marks on one letter; no script needs more, floods have hundreds
_SHORT: Final = {"\b": "\\b", "\t": "\\t", "\n": "\\n", "\f": "\\f", "\r": "\\r"}
_ELLIPSIS: Final = "…"


def printable(text: str, most: int = MOST) -> str:
    r"""Return a text in one line that a terminal only shows.

    Control characters, line breaks, marks of direction, unpaired surrogates and what else has no
    shape become escapes; of combining marks a letter keeps three.

    >>> print(printable("FCV\x1b]0;owned\x07\n\u202e.U"), printable("x" * 9, most=5))
    FCV\x1b]0;owned\x07\n\u202e.U xxxx…
    """
    if len(text) > most:
        text = text[: most - 1] + _ELLIPSIS
    if text.isascii() and text.isprintable():
        return text
    shown: list[str] = []
    marks = 0
    for c in text:
        marks = marks + 1 if unicodedata.category(c)[0] == "M" else 0
        if marks <= _MARKS:
            shown.append(c if c.isprintable() else ascii(c)[1:-1])
    return "".join(shown)


def printable_lines(text: str) -> str:
    r"""Return a text of ours that may have several lines, each of them printable.

    >>> printable_lines("two\nlines\x1b")
    'two\nlines\\x1b'
    """
    return "\n".join(printable(line, LINE) for line in text.split("\n"))


def toml_string(text: str) -> str:
    r"""Return a basic string of TOML 1.0 that loads as this text.

    Raises
    ------
    ValueError
        if it holds an unpaired surrogate: TOML has none.

    >>> print(toml_string('Öl "1"\x7f'))
    "Öl \"1\"\u007F"
    """
    return f'"{"".join(map(_toml_character, text))}"'


def _toml_character(c: str) -> str:
    code = ord(c)
    if 0xD800 <= code <= 0xDFFF:
        raise ValueError(f"an unpaired surrogate, U+{code:X}, is no character")
    if c in {'"', "\\"}:
        return f"\\{c}"
    if c.isprintable():
        return c
    return _SHORT.get(c, f"\\u{code:04X}" if code < 0x10000 else f"\\U{code:08X}")
