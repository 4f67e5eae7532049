"""Sweep with all stacks, and write results and page: ``make conformance``."""

import asyncio
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from conformance.stacks import STACKS
from conformance.sweep import sweeps
from documentation.sweeps import kept_results, write

CACHE = Path(__file__).parents[2] / ".pytest_cache" / "d"


def cache(name):
    folder = CACHE / name
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def main():
    """Keep the results of a stack that cannot be started here; exit code 1 then."""
    results, missing = kept_results(), []
    for name, stack in STACKS.items():
        try:
            program = stack.program(cache)
        except pytest.skip.Exception as why:
            missing.append(f"{name}: not swept: {why}")
            continue
        with TemporaryDirectory() as folder:
            found = asyncio.run(sweeps(program, Path(folder)))
        results[name] = {"version": stack.version(), **found}
        print(f"{name}: swept", flush=True)
    write(results)
    print("\n".join(missing), file=sys.stderr)
    return bool(missing)


if __name__ == "__main__":
    sys.exit(main())
