"""An installed wheel with compiled kernels: ``python -m benchmarks.installed_wheel [ROUNDS]``.

The wheel is that of ``make wheel``. Each round installs it at a new path, and starts the demo there
twice: the first start over the second, to the first published result. Then a long and a short
recording are replayed by all estimators, in turns with these kernels and with those that this
machine compiles for itself: the processor time by which the long one takes longer, of the second
over that of the first.
"""

import os
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

from benchmarks.first_start import demo, environment_of

RECORDED_S: Final = 60, 3_660


def built(folder: Path) -> Path:
    """Build the wheel, with the kernels of every kind of machine."""
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder]
    environment = os.environ | {"VALVEMAP_KERNELS": sys.executable}
    subprocess.run([*command, "."], env=environment, check=True)
    (wheel,) = folder.glob("*.whl")
    return wheel


def installed(wheel: Path, home: Path) -> dict[str, str]:
    """Install the wheel; return the environment that imports it, where nothing may be compiled."""
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", home]
    subprocess.run([*command, wheel], check=True)
    return environment_of(home) | {"PYTHONPATH": str(home), "NUMBA_CACHE_DIR": str(home / "cache")}


def starts(wheel: Path, folder: Path) -> tuple[float, float]:
    """Seconds to the first published result of a wheel just installed, and once more."""
    folder.mkdir()
    environment = installed(wheel, folder / "home")
    first, again = (demo(folder, environment)["first result, s"] for _ in range(2))
    return first, again


def replayed(recordings: list[Path], environment: dict[str, str]) -> float:
    """Processor time by which the second recording takes longer than the first, s."""
    took = []
    for recording in recordings:
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        run(["replay", str(recording)], recording.parent, environment)
        took.append(resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before)
    return took[1] - took[0]


def recorded(folder: Path, seconds: int, environment: dict[str, str]) -> Path:
    """Record the rig for some seconds."""
    file = folder / f"recorded-{seconds}.csv"
    options = ["--offline", "--duration", str(seconds), "--record", str(file)]
    run(["rig", *options], folder, environment)
    return file


def run(arguments: list[str], folder: Path, environment: dict[str, str]) -> None:
    """Run valvemap, without its output."""
    command = [sys.executable, "-m", "valvemap", *arguments]
    subprocess.run(command, cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL)


def main(arguments: list[str]) -> int:
    """Measure some times, and print every figure and the medians."""
    rounds = range(int(arguments[0]) if arguments else 3)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        wheel = built(folder)
        print(f"wheel: {wheel.stat().st_size / 1e6:.1f} MB", flush=True)
        both = [starts(wheel, folder / str(n)) for n in rounds]
        ratios = [first / again for first, again in both]
        print(f"first result, first and second start: {[tuple(map(fine, one)) for one in both]} s")
        print(f"first over second: median {statistics.median(ratios):.2f}", flush=True)
        of_wheel, native = installed(wheel, folder / "replays"), environment_of(Path.cwd())
        files = [recorded(folder, seconds, native) for seconds in RECORDED_S]
        for environment in (native, of_wheel):
            replayed(files[:1] * 2, environment)  # compiles, if anything
        pairs = [(replayed(files, native), replayed(files, of_wheel)) for _ in rounds]
        speeds = [own / ahead for own, ahead in pairs]
        print(f"an hour more, own and the wheel's: {[tuple(map(fine, one)) for one in pairs]} s")
        print(f"share of native speed: median {statistics.median(speeds):.2f}")
    return 0


def fine(seconds: float) -> float:
    """Rounded for print."""
    return round(seconds, 2)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
