"""Exceptions of a failed release."""


class ReleaseError(Exception):
    """A message for the user; exit code 1."""

    exit_code = 1


class WrongUse(ReleaseError):  # noqa: N818 - it says what happened
    """An argument is missing or wrong."""

    exit_code = 2
