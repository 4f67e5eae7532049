"""Why a release cannot be made."""


class ReleaseError(Exception):
    """A sentence for who makes the release; exit code 1."""

    exit_code = 1


class WrongUse(ReleaseError):  # noqa: N818 - it says what happened
    """An argument is missing or wrong."""

    exit_code = 2
