"""Write the reference pages: ``python -m documentation``."""

from documentation.pages import REFERENCE, pages


def main() -> None:
    """Write every page anew."""
    for name, text in pages().items():
        (REFERENCE / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
