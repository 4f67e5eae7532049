"""Trends: courses of a valve's variables from the service's history, in tiles that viewers share.

A trend is mean, least and largest value of equal intervals whose starts are multiples of their
length. So a panned or zoomed trend consists of the same intervals, and past ones are read once.
Where the service keeps no history, the page answers with the values it has seen.
"""

import asyncio
from collections import OrderedDict
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.clock import Clock
from valvemap.errors import CommandRejected, SourceLost
from valvemap.page.layout import Part, Valve
from valvemap.page.ports import Client
from valvemap.page.seen import Seen
from valvemap.readings import ConditionChange
from valvemap.vocabulary.history_columns import OF_AXES, REQUIRED_U, REQUIRED_U_STATUS
from valvemap.vocabulary.quantities import HISTORY_QUANTITIES
from valvemap.vocabulary.signals import PUBLISHED

STEPS_MS: Final = (
    *(100, 200, 500, 1_000, 2_000, 5_000, 10_000, 30_000, 60_000, 120_000, 300_000),
    *(600_000, 1_800_000, 3_600_000, 7_200_000, 14_400_000),
)
MOST_INTERVALS: Final = 2_000
MOST_NAMES: Final = 16
_TILE = 120  # intervals
_MOST_TILES = 3_000  # 2 kB each
_SETTLES_S = 20.0  # rows of the history may come so late
_TOGETHER_S = 900.0  # longer tiles are read some variables at a time: no request takes long
_TOGETHER = 4  # variables of one request, once it is known to take no longer for them
_MOST_AT_ONCE = MOST_INTERVALS // _TILE + 1  # longer tiles of one request
_SLOW_S = 1.0  # a request after which single tiles are read; after a shorter one, more at once
_KINDS = ("Average", "Minimum", "Maximum")
_DOUBT = len(_KINDS)  # row of a tile: 0 all values are Good, 1 some are, NaN none is
_ROWS = _DOUBT + 1
_UNCERTAIN, _BAD = 0x4000_0000, 0x8000_0000
_MS = 1_000_000  # ns


@dataclass(frozen=True)
class Trend:
    """Courses of some variables at common intervals.

    Attributes
    ----------
    start, step
        Start of the first interval and length of each, UTC ns.
    courses
        By variable: mean, least and largest value, (3, n) each; NaN: no value.
    doubts
        By variable, (n,): 0 all values of an interval are Good, 1 some are, 2 none is.
    is_kept
        Whether it comes from the service's history, instead of what the page has seen.
    since
        The oldest time that the page has seen, UTC ns.
    """

    start: int
    step: int
    courses: Sequence[NDArray[np.float32]]
    doubts: Sequence[NDArray[np.uint8]]
    is_kept: bool
    since: int


def recorded(valve: Valve | Part) -> tuple[str, ...]:
    """Return the names of a valve's or axis' variables that have a history.

    >>> recorded(Valve("V1", ("RLS",), ()))[-4:]
    ('RLS.NoiseStd', 'RLS.Status', 'Inverse.RequiredU', 'Inverse.RequiredUStatus')
    """
    answers = tuple(f"Inverse.{name}" for name in (REQUIRED_U, REQUIRED_U_STATUS))
    if isinstance(valve, Part):
        return (*sorted(OF_AXES), *answers)
    of_estimators = (
        f"{estimator}.{quantity.name}"
        for estimator in valve.estimators
        for quantity in HISTORY_QUANTITIES
    )
    return (*(f"Signals.{name}" for name in PUBLISHED), *of_estimators, *answers)


class Trends:
    """Reads trends, one at a time, so that the service's own work goes first.

    Parameters
    ----------
    client
        A client of the service. One for the past alone is connected when it is needed, and a long
        read then holds up nothing that is live.
    clock
        Decides which tiles are past.
    is_shared
        Whether the client is the observer's own, which connects it.
    """

    def __init__(self, client: Client, clock: Clock, *, is_shared: bool = False) -> None:
        self._client, self._clock = client, clock
        self._tiles: OrderedDict[tuple[str, str, int, int], NDArray[np.float32]] = OrderedDict()
        self._seen: dict[str, Seen] = {}
        self._keeps_none = self._is_connected = False
        self._is_shared = is_shared
        self._at_once = 1  # tiles
        self._turn = asyncio.Lock()

    def forget(self) -> None:
        """Drop all values, after a reconnect: the history may be another one."""
        self._tiles.clear()
        self._keeps_none = self._is_connected = False

    async def close(self) -> None:
        """Disconnect a client of the past alone."""
        self._is_connected = False
        if not self._is_shared:
            await self._client.close()

    def see(self, valve: Valve, valves: int, t: int, row: dict[str, float]) -> None:
        """Keep a row of a valve (UTC ns; values by name), for a service without a history."""
        if not t:
            return
        seen = self._seen.get(valve.name)
        if seen is None:
            framed = frozenset(valve.frame_names)
            names = [name for name in recorded(valve) if name in framed]
            self._seen[valve.name] = seen = Seen(names, valves)
        seen.add(t, row)

    async def read(
        self, valve: Valve | Part, names: Sequence[str], span: tuple[int, int], step: int
    ) -> Trend:
        """Return the trend of variables with a history over a span, UTC ns, at intervals ``step``.

        Raises
        ------
        SourceLost, SourceRejected
        """
        first, last = span[0] // step, -(-span[1] // step)
        if not self._keeps_none:
            try:
                async with self._connection():
                    await self._fetch(valve.name, names, first // _TILE, (last - 1) // _TILE, step)
                cut = [self._cut(valve.name, name, first, last, step) for name in names]
                return Trend(
                    start=first * step,
                    step=step,
                    courses=[found[:_DOUBT] for found in cut],
                    doubts=[
                        np.nan_to_num(found[_DOUBT], nan=2.0).astype(np.uint8) for found in cut
                    ],
                    is_kept=True,
                    since=self._since(valve.name),
                )
            except CommandRejected:
                self._keeps_none = True
        seen = self._seen.get(valve.name) or Seen((), 1)
        courses = [seen.bucketed(name, first * step, step, last - first) for name in names]
        doubts = [np.where(np.isnan(course[0]), 2, 0).astype(np.uint8) for course in courses]
        return Trend(first * step, step, courses, doubts, is_kept=False, since=seen.since)

    async def past_conditions(self, span: tuple[int, int], most: int) -> Sequence[ConditionChange]:
        """Return the newest changes of all alarms in a span (UTC ns), the newest first.

        Raises
        ------
        CommandRejected
            if the service keeps none.
        SourceLost, SourceRejected
        """
        async with self._connection():
            return await self._client.past_conditions(span, most)

    @asynccontextmanager
    async def _connection(self) -> AsyncIterator[None]:
        """Wait for the turn, and connect if that is needed."""
        async with self._turn:
            try:
                if not self._is_connected and not self._is_shared:
                    await self._client.connect()
                self._is_connected = True
                yield
            except SourceLost:
                self._is_connected = False
                raise

    def _since(self, name: str) -> int:
        return self._seen[name].since if name in self._seen else 0

    async def _fetch(
        self, valve: str, names: Sequence[str], first: int, last: int, step: int
    ) -> None:
        """Read the tiles that are missing or not past yet."""
        now, width = self._clock.now(), _TILE * step
        last = min(last, now // width)
        is_short = width <= _TOGETHER_S * 1e9
        left = list(names)
        while left:
            quickly = self._at_once >= _MOST_AT_ONCE
            together = len(left) if is_short else _TOGETHER if quickly else 1
            some, left = left[:together], left[together:]
            index = first
            while index <= last:
                missing = self._missing(valve, some, step, index)
                count = 1
                if missing and not is_short:
                    while (
                        count < self._at_once
                        and index + count <= last
                        and self._missing(valve, some, step, index + count) == missing
                    ):
                        count += 1
                if missing:
                    end = min((index + count) * width, -(-now // step) * step)
                    began = self._clock.monotonic()
                    await self._read_tiles(valve, missing, index, (index * width, end), step)
                    self._pace(self._clock.monotonic() - began)
                index += count
        while len(self._tiles) > _MOST_TILES:
            self._tiles.popitem(last=False)

    def _missing(self, valve: str, names: Sequence[str], step: int, index: int) -> list[str]:
        return [name for name in names if (valve, name, step, index) not in self._tiles]

    def _pace(self, took_s: float) -> None:
        """Ask for more tiles at once until a request takes long.

        From summaries it takes as long for many tiles as for one, also on a machine that is busy
        with others; a service that has just started reads all values instead.
        """
        self._at_once = 1 if took_s > _SLOW_S else min(4 * self._at_once, _MOST_AT_ONCE)

    async def _read_tiles(
        self, valve: str, names: Sequence[str], first: int, span: tuple[int, int], step: int
    ) -> None:
        """Keep successive tiles, the first one of which has this index."""
        asked = [(f"{valve}.{name}", kind) for name in names for kind in _KINDS]
        found = await self._client.courses(asked, span, step)
        if all(course.code in _NO_HISTORY for course in found):
            raise CommandRejected("no history is kept")
        count = -(-(span[1] - span[0]) // (_TILE * step))
        for k, name in enumerate(names):
            tiles = np.full((count, _ROWS, _TILE), np.nan, np.float32)
            for row, course in enumerate(found[k * len(_KINDS) : (k + 1) * len(_KINDS)]):
                places = (np.array(course.times, np.int64) - span[0]) // step
                inside = (places >= 0) & (places < count * _TILE)
                tile, column = np.divmod(places[inside], _TILE)
                tiles[tile, row, column] = np.array(course.values, np.float32)[inside]
                if row == 0:
                    codes = np.array(course.codes, np.uint32)[inside]
                    tiles[tile, _DOUBT, column] = np.where(
                        codes >= _BAD, np.nan, codes >= _UNCERTAIN
                    )
            for place, tile_ in enumerate(tiles):
                self._tiles[valve, name, step, first + place] = tile_.copy()

    def _cut(self, valve: str, name: str, first: int, last: int, step: int) -> NDArray[np.float32]:
        """Join tiles; forget those that may still grow."""
        found = np.full((_ROWS, last - first), np.nan, np.float32)
        settled = self._clock.now() - int(_SETTLES_S * 1e9)
        for index in range(first // _TILE, (last - 1) // _TILE + 1):
            key = valve, name, step, index
            tile = self._tiles.get(key)
            if tile is None:
                continue
            low, high = max(first, index * _TILE), min(last, (index + 1) * _TILE)
            found[:, low - first : high - first] = tile[
                :, low - index * _TILE : high - index * _TILE
            ]
            if (index + 1) * _TILE * step > settled:
                del self._tiles[key]
            else:
                self._tiles.move_to_end(key)
        return found


_NO_HISTORY = frozenset(
    {
        0x8072_0000,  # BadHistoryOperationUnsupported
        0x8071_0000,  # BadHistoryOperationInvalid
        0x803D_0000,  # BadNotSupported
        0x801F_0000,  # BadUserAccessDenied
    }
)
