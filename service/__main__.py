"""``python -m service`` is ``valvemap``."""

from service.cli import main

main()
