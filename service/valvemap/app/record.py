"""Records the aligned samples of a source to a file."""

import asyncio
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import structlog

from valvemap.app.build import build_alignment, build_timing
from valvemap.app.connections import build_source, build_supervisor_settings
from valvemap.clock import SystemClock
from valvemap.config.loading import check_has_valves
from valvemap.config.models import Config
from valvemap.errors import SourceError
from valvemap.model.samples import Times
from valvemap.owned_files import write_whole
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.data_changes import DataChanges
from valvemap.runtime.failure_log import log_left_out, log_missing
from valvemap.runtime.supervisor import supervise
from valvemap.storage.recording_writer import RecordingWriter

log = structlog.get_logger(__name__)


async def record(
    config: Config,
    file: Path,
    stop: asyncio.Event,
    duration_s: float | None = None,
    progress: Callable[[int], None] = lambda _samples: None,
) -> int:
    """Write the source's samples to ``file`` until ``stop`` is set or ``duration_s`` has elapsed.

    If the signals had no common timestamps, ``FILE.timing.json`` records the timing of each.
    ``progress`` is called with the number of samples after each write.

    Returns
    -------
    int
        Number of samples written.

    Raises
    ------
    SourceError, StorageError, RecordingError
    """
    check_has_valves(config, "recording")
    clock = SystemClock()
    with RecordingWriter(file) as writer:
        recorder = _Recorder(config, writer, progress)
        ends = None
        if duration_s is not None:
            ends = asyncio.get_running_loop().call_later(duration_s, stop.set)
        try:
            await supervise(
                build_source(config), recorder, clock, stop, build_supervisor_settings(config)
            )
            recorder.finish()
        finally:
            if ends is not None:
                ends.cancel()
            if not recorder.samples:
                writer.discard()
    recorder.write_timing(file)
    return recorder.samples


async def record_history(
    config: Config,
    file: Path,
    start: int,
    stop: int,
    progress: Callable[[int], None] = lambda _samples: None,
) -> int:
    """Write the source's history of a time span (UTC ns) to ``file``, as `record` would.

    Raises
    ------
    SourceError, StorageError, RecordingError
    """
    check_has_valves(config, "recording")
    with RecordingWriter(file) as writer:
        recorder = _Recorder(config, writer, progress)
        try:
            async for changes in build_source(config).recall(start, stop):
                await recorder.take(changes)
            recorder.finish()
        finally:
            if not recorder.samples:
                writer.discard()
    recorder.write_timing(file)
    return recorder.samples


class _Recorder:
    """Fulfils :class:`valvemap.runtime.supervisor.Consumer`."""

    def __init__(
        self, config: Config, writer: RecordingWriter, progress: Callable[[int], None]
    ) -> None:
        self._names = [valve.name for valve in config.valves]
        self._arrivals = Arrivals(self._names, build_alignment(config), build_timing(config))
        self._writer = writer
        self._progress = progress
        self.samples = 0

    async def connected(self, _valves: Times | None = None, *, restarted_at: int | None) -> None:
        """Note the connection; after a restart of the source, restart the sample sequence."""
        if restarted_at is not None:
            self._append(
                self._arrivals.begin_source_anew(np.arange(len(self._names)), restarted_at)
            )

    async def take(self, changes: DataChanges, _valves: Times | None = None) -> None:
        self._append(self._arrivals.take(changes))

    def finish(self) -> None:
        """Write the pending samples."""
        for samples in self._arrivals.finish():
            self._append(samples)
        log_missing(self._arrivals.left_out())

    def write_timing(self, file: Path) -> None:
        """Write the timing of the signals to a file beside the recording.

        Raises
        ------
        StorageError
        """
        found = self._arrivals.timing.found_by(self._names)
        if not found:
            return
        beside = file.with_name(f"{file.name}.timing.json")
        write_whole(beside, json.dumps(found, indent=2, ensure_ascii=False))

    def _append(self, samples: ByValve) -> None:
        for left_out, error in self._arrivals.buffers.new_failures():
            log_left_out(self._names[left_out], error)
        for valve, batch in samples.items():
            self._writer.append(self._names[valve], batch)
            self.samples += len(batch)
        self._progress(self.samples)

    async def tick(self, _valves: Times | None = None) -> None:
        pass

    async def lost(self, reason: SourceError, _valves: Times | None = None) -> None:
        log.warning("recording has a gap", reason=str(reason))
