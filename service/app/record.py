"""Recording a source: aligned samples, as they come, into a file."""

import asyncio
from pathlib import Path

import structlog

from service.app.build import build_alignment, build_source, build_supervisor_settings
from service.clock import SystemClock
from service.config.models import Config
from service.errors import SourceError
from service.storage.recordings import RecordingWriter
from service.streaming.data_changes import DataChanges
from service.streaming.supervisor import supervise

log = structlog.get_logger(__name__)


async def record(
    config: Config, file: Path, stop: asyncio.Event, duration_s: float | None = None
) -> int:
    """Write the source's samples to ``file`` until ``stop`` is set or ``duration_s`` is over.

    Returns
    -------
    int
        Number of samples written.

    Raises
    ------
    SourceError, StorageError, RecordingError
    """
    clock = SystemClock()
    with RecordingWriter(file) as writer:
        recorder = _Recorder(config, writer)
        ends = None
        if duration_s is not None:
            ends = asyncio.get_running_loop().call_later(duration_s, stop.set)
        try:
            await supervise(
                build_source(config), recorder, clock, stop, build_supervisor_settings(config)
            )
        finally:
            if ends is not None:
                ends.cancel()
    return recorder.samples


class _Recorder:
    """Fulfils :class:`service.streaming.supervisor.Consumer`."""

    def __init__(self, config: Config, writer: RecordingWriter) -> None:
        self._names = [valve.name for valve in config.valves]
        self._alignment = build_alignment(config)
        self._waiting = self._alignment.initial_state()
        self._writer = writer
        self.samples = 0

    async def connected(self, source_started: int) -> None:
        pass

    async def take(self, changes: DataChanges) -> None:
        self._waiting, samples = self._alignment.update(self._waiting, changes)
        for valve, batch in samples.items():
            self._writer.append(self._names[valve], batch)
            self.samples += len(batch)

    async def tick(self) -> None:
        pass

    async def lost(self, reason: SourceError) -> None:
        log.warning("recording has a gap", reason=str(reason))
