"""``python -m valvemap`` is ``valvemap``."""

from valvemap.cli import main

main()
