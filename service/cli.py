"""The command ``valvemap``."""


def main() -> None:
    """Run the command line."""
