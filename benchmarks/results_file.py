"""Figures of benchmarks as a file: whole or as it was before, whatever ends the program."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np


def keep(file: Path, record: Mapping[str, Any]) -> None:
    """Write a record; numpy's numbers and truths as JSON's."""
    file.parent.mkdir(parents=True, exist_ok=True)
    beside = file.with_suffix(".part")
    text = json.dumps(record, indent=2, ensure_ascii=False, default=_plain)
    beside.write_text(text + "\n", "utf-8")
    beside.replace(file)


def _plain(number: Any) -> Any:
    assert isinstance(number, np.generic)  # noqa: S101 - nothing else is left to JSON
    return number.item()
