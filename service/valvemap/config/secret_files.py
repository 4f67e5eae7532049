"""Passwords that lie in files."""

from pathlib import Path

from valvemap.errors import ConfigurationError


def read_secret(file: Path) -> str:
    """The first line of a file that holds a password.

    Raises
    ------
    ConfigurationError
        naming the file.
    """
    try:
        return file.read_text(encoding="utf-8").splitlines()[0]
    except (OSError, IndexError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it holds no password"
        raise ConfigurationError(f"{file}: {str(reason).lower()}") from None
