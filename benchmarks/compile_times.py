"""What the first start on a machine compiles, and how long each kernel takes.

``python -m benchmarks.compile_times [CONFIGURATION]`` compiles everything into an empty cache, in
this process alone, and prints the seconds of each kernel without those that it calls, and how
often it is compiled. Signatures beyond one are what sharing would save.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path


def main(arguments: list[str]) -> int:
    """Restart with an empty cache: numba reads its folder on import."""
    if "NUMBA_CACHE_DIR" in os.environ and arguments[:1] == ["here"]:
        return _measure(arguments[1:])
    with tempfile.TemporaryDirectory() as cache:
        command = [sys.executable, "-m", "benchmarks.compile_times", "here", *arguments]
        return subprocess.run(
            command, env=os.environ | {"NUMBA_CACHE_DIR": cache}, check=False
        ).returncode


def _measure(arguments: list[str]) -> int:
    from numba.core import event  # noqa: PLC0415 - after the cache is named

    began = time.perf_counter()
    with event.install_recorder("numba:compile") as recorder:
        from valvemap.app import warm_up  # noqa: PLC0415 - some kernels compile when imported
        from valvemap.config.loading import load_config  # noqa: PLC0415

        imported = time.perf_counter() - began
        config = load_config(Path(arguments[0])) if arguments else load_config()
        warm_up.compile_here(config)
    spent: Counter[str] = Counter()
    times: Counter[str] = Counter()
    stack: list[tuple[str, float]] = []
    last = 0.0
    for moment, entry in recorder.buffer:
        if stack:
            spent[stack[-1][0]] += moment - last
        if entry.is_start:
            function = entry.data["dispatcher"].py_func
            name = f"{function.__module__.removeprefix('valvemap.')}.{function.__name__}"
            times[name] += 1
            stack.append((name, moment))
        else:
            stack.pop()
        last = moment
    for name, seconds in spent.most_common():
        print(f"{seconds:7.2f} s {times[name]:3} x {name}")
    whole = time.perf_counter() - began
    print(f"{sum(spent.values()):7.2f} s of {whole:.2f} s, of which {imported:.2f} s are imports")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
