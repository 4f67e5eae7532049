"""Reads passwords from files."""

from pathlib import Path

from valvemap.errors import ConfigurationError


def read_secret(file: Path) -> str:
    """Return the first line of a password file.

    Raises
    ------
    ConfigurationError
        if it cannot be read; names the file.
    """
    try:
        return file.read_text(encoding="utf-8").splitlines()[0]
    except (OSError, IndexError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it holds no password"
        raise ConfigurationError(f"{file}: {str(reason).lower()}") from None
