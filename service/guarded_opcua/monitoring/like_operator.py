"""The operator Like of event filters (Part 4, table 120), in O(text × pattern) time."""

import functools
from collections.abc import Callable, Iterator

MAX_PATTERN, _MAX_TEXT = 100, 1_000

Test = Callable[[str], bool]


def like(text: str, pattern: str) -> bool:
    r"""Return whether a text matches a pattern of ``%``, ``_``, ``[a-c]``, ``[^x]`` and ``\``.

    >>> like("valve 7", "valve [0-9]"), like("valve x", "valve [^0-9]"), like("100 %", r"%\%")
    (True, True, True)
    """
    if len(pattern) > MAX_PATTERN:
        return False
    tests, text = list(_tests(pattern)), text[:_MAX_TEXT]
    at = number = 0
    restart: tuple[int, int] | None = None  # after the last %: index of its test, position
    while at < len(text):
        test = tests[number] if number < len(tests) else _nothing
        if test is None:
            number += 1
            restart = (number, at)
        elif test(text[at]):
            at, number = at + 1, number + 1
        elif restart is not None:
            number, at = restart[0], restart[1] + 1
            restart = (number, at)
        else:
            return False
    return all(test is None for test in tests[number:])


def _tests(pattern: str) -> Iterator[Test | None]:
    """Parse a pattern: a test for each character, None for ``%``."""
    at = 0
    while at < len(pattern):
        sign, at = pattern[at], at + 1
        if sign == "%":
            yield None
        elif sign == "_":
            yield _anything
        elif sign == "[" and (end := pattern.find("]", at + 1)) > 0:
            listed, at = pattern[at:end], end + 1
            yield functools.partial(_fits, listed)
        else:
            if sign == "\\" and at < len(pattern):
                sign, at = pattern[at], at + 1
            yield sign.__eq__


def _anything(_: str) -> bool:
    return True


def _nothing(_: str) -> bool:
    return False


def _fits(listed: str, sign: str) -> bool:
    if listed.startswith("^"):
        return not _is_listed(listed[1:], sign)
    return _is_listed(listed, sign)


def _is_listed(listed: str, sign: str) -> bool:
    at = 0
    while at < len(listed):
        if listed[at + 1 : at + 2] == "-" and at + 2 < len(listed):
            if listed[at] <= sign <= listed[at + 2]:
                return True
            at += 3
        elif listed[at] == sign:
            return True
        else:
            at += 1
    return False
