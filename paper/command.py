"""The command that reproduces the paper on the virtual rig, with a verdict on every claim."""

from pathlib import Path

from rich.table import Table

from paper.build import STEPS, as_json, build
from paper.motion import Motion
from paper.page import html_page
from paper.rig import measure
from paper.source_types import SourceTypes
from valvemap.cli.output import terminal
from valvemap.cli.progress import bars
from valvemap.cli.replay import write_json
from valvemap.errors import StorageError
from valvemap.owned_files import write_whole

_FASTER = 10.0
_MOTION_SEED = _TYPES_SEED = 1


def rebuild(out: Path, sets: int, rate: float) -> None:
    """Measure, evaluate and write paper.html, paper.json and the pictures to ``out``.

    Parameters
    ----------
    out
        The folder; created if missing.
    sets
        Number of sets of recordings; the verdicts use their median.
    rate
        Sampling rate, Hz; one additional set has ten times this rate.

    Raises
    ------
    StorageError
        naming the file that cannot be written.
    """
    _make(out)
    with bars() as bar:
        task = bar.add_task("measuring", total=2 * sets + 2 + STEPS)

        def progress(step: str) -> None:
            bar.update(task, description=step, advance=1)

        data = []
        for seed in range(1, sets + 1):
            data.append(measure(rate, seed))
            progress("measuring")
        motion = Motion.measured(_MOTION_SEED)
        progress("a cylinder has followed its moves")
        types = SourceTypes.measured(_TYPES_SEED)
        progress("maps from the source data of Figure 1")
        quicker = measure(_FASTER * rate)
        result = build(data, quicker, motion=motion, types=types, progress=progress)
        bar.update(task, completed=2 * sets + 2 + STEPS, description="done")
    pictures = {f"{picture.key}.png": picture.png for picture in result.pictures}
    _write(out, {"paper.html": html_page(result).encode(), **pictures})
    write_json(out / "paper.json", as_json(result))
    table = Table("#", "verdict", "sets", f"at {result.faster_hz:g} Hz", "claim")
    for claim, faster in zip(result.claims, result.claims_faster, strict=True):
        other = "the same" if faster.verdict is claim.verdict else str(faster.verdict)
        agreeing = f"{claim.agreeing}/{claim.sets or result.sets}"
        table.add_row(str(claim.number), str(claim.verdict), agreeing, other, claim.text)
    console = terminal()
    console.print(table)
    console.print(f"written: {out / 'paper.html'}")


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{folder}: {(error.strerror or str(error)).lower()}") from None


def _write(folder: Path, files: dict[str, bytes]) -> None:
    for name, content in files.items():
        write_whole(folder / name, content)
