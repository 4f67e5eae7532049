"""Write the reference pages, and the types as a UANodeSet: ``python -m documentation``."""

from documentation.node_set import node_set
from documentation.pages import NODE_SET, REFERENCE, pages


def main() -> None:
    """Write every page anew."""
    for name, text in pages().items():
        (REFERENCE / name).write_text(text, encoding="utf-8")
    NODE_SET.write_text(node_set(), encoding="utf-8")


if __name__ == "__main__":
    main()
