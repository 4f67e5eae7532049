"""Draw the figures of docs/methods: ``python -m documentation.figures [PAGE…]``."""

import sys

from documentation.figures import FIGURES
from documentation.figures.canvas import write


def main(pages: list[str]) -> int:
    """Draw the figures of the pages named, or of all; return the exit code."""
    unknown = [page for page in pages if page not in FIGURES]
    if unknown:
        sys.stderr.write(f"no page {', '.join(unknown)}; pages: {', '.join(FIGURES)}\n")
        return 2
    for page in pages or FIGURES:
        path = write(FIGURES[page](), page)
        sys.stdout.write(f"{path.name}: {path.stat().st_size / 1000:.0f} kB\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
