"""Interface of all estimators, and serialization of their states."""

import hashlib
import io
import json
import struct
import sys
from ast import literal_eval
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any, ClassVar, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from valvemap.model.contents import Contents
from valvemap.model.samples import Floats, Samples, Trace, columns_of, field_names
from valvemap.vocabulary.statuses import Adaptation


class StateMismatchError(ValueError):
    """The bytes belong to another estimator, other hyper-parameters or another version."""


@dataclass(frozen=True)
class State:
    """Base of all estimator states: a frozen dataclass whose fields are arrays.

    Scalars are arrays of shape (): the bytes are one record in a ``.npy``, which numpy can read.
    ``state_version`` increases when the meaning of an array changes; states of other versions are
    rejected, but for those that `upgraded` knows.
    """

    state_version: ClassVar[int] = 2

    def to_bytes(self, key: str) -> bytes:
        """Serialize the state; ``key`` identifies the hyper-parameters."""
        kind = type(self)
        arrays = [
            array if type(array) is np.ndarray else np.asarray(array) for array in columns_of(self)
        ]
        names = str(kind.state_version), kind.__name__, key
        layout = tuple([(array.dtype, array.shape) for array in arrays])
        head, header = _npy_head(names, field_names(kind), layout)
        return b"".join([head, *[array.tobytes() for array in arrays], header])

    @classmethod
    def from_bytes(cls, data: bytes, key: str) -> Self:
        """Deserialize a state.

        Raises
        ------
        StateMismatchError
            if version, state type or ``key`` differ, or the bytes are damaged.
        """
        expected = (str(cls.state_version), cls.__name__, key)
        try:
            record = _record(data)
            _check_texts(record)
            header = tuple(record["header_"].tolist())
            names = record.dtype.names if header[1:] == expected[1:] else ()
            arrays = {name: record[name].copy() for name in names if name != "header_"}
            if arrays and header != expected:
                arrays = cls.upgraded(header[0], arrays)
                header = expected if arrays else header
            if header == expected:
                arrays = {name: arrays[name] for name in field_names(cls)}
        except _UNREADABLE as error:
            raise StateMismatchError(f"not a state of {cls.__name__}: {error}") from error
        if header != expected:
            raise StateMismatchError(_difference(header, expected))
        return cls(**arrays)

    @classmethod
    def upgraded(cls, version: str, arrays: dict[str, Any]) -> dict[str, Any]:  # noqa: ARG003
        """Convert the arrays of an older version to this one; empty if that version is unknown."""
        return {}

    def contents(self) -> Mapping[str, Contents]:
        """Valid values of the arrays by name; for arrays not named see `Contents`."""
        return {}

    def check(self, like: Self) -> None:
        """Reject invalid values: a valid digest does not imply a valid state.

        Raises
        ------
        StateMismatchError
            naming the first array that differs in shape or type from the one in ``like``, a state
            of the same estimator, or has an invalid value.
        """
        Template(like).check(self)

    def is_coherent(self) -> bool:
        """Whether the arrays, each valid, are consistent with each other."""
        return True


@lru_cache(maxsize=1024)  # 2 MB; each number of samples that wait has its own
def _npy_head(
    header: tuple[str, ...],
    names: tuple[str, ...],
    layout: tuple[tuple[np.dtype[Any], tuple[int, ...]], ...],
) -> tuple[bytes, bytes]:
    """Return the header of numpy and ours; cached: they would take longer than the arrays."""
    ours = np.array(header)
    every = zip((*names, "header_"), (*layout, (ours.dtype, ours.shape)), strict=True)
    record = np.zeros((), [(name, of.str, shape) for name, (of, shape) in every])
    buffer = io.BytesIO()
    np.save(buffer, record, allow_pickle=False)
    return buffer.getvalue()[: -record.nbytes], ours.tobytes()


@lru_cache(maxsize=256)
def _npy_kind(head: bytes) -> np.dtype[Any]:
    """Return the type of the record with this header of numpy's; cached, as `_npy_head`."""
    parsed = literal_eval(head.decode("latin1").strip())
    kind = np.lib.format.descr_to_dtype(parsed["descr"])
    if parsed["shape"] != () or kind.hasobject:
        raise ValueError("not one record of numbers and texts")
    return kind


def _difference(header: tuple[str, ...], expected: tuple[str, str, str]) -> str:
    """Return in what two states differ: type, version or hyper-parameters."""
    if len(header) != len(expected) or header[1] != expected[1]:
        return f"it is a state of {' '.join(map(str, header[1:2]))}, not of {expected[1]}"
    if header[0] != expected[0]:
        return f"it is a state of version {header[0]}, version {expected[0]} is needed"
    return "it is a state of other hyper-parameters"


def _record(data: bytes) -> Any:  # noqa: ANN401 - a record of named arrays
    """Return the record of a ``.npy`` of version 1.0, as `numpy.load` does for an intact one.

    `numpy.load` tries a damaged header again as one of Python 2, which takes milliseconds.
    """
    if data[: len(_MAGIC)] != _MAGIC:
        raise ValueError("no record of arrays")
    (length,) = struct.unpack_from("<H", data, len(_MAGIC))
    begin = len(_MAGIC) + 2
    if length > _HEADER_BYTES:
        raise ValueError(f"a header of {length} bytes, at most {_HEADER_BYTES} are allowed")
    kind = _npy_kind(data[begin : begin + length])
    return np.frombuffer(data, kind, 1, begin + length).reshape(())


class Template:
    """Checks many states of one estimator against ``like``, one of them."""

    def __init__(self, like: State) -> None:
        said = like.contents()
        self._contents = {
            name: said.get(name) or Contents(np.asarray(getattr(like, name)))
            for name in field_names(type(like))
        }

    def check(self, state: State) -> None:
        """As `State.check`."""
        for name, contents in self._contents.items():
            wrong = contents.wrong_in(np.asarray(getattr(state, name)))
            if wrong is not None:
                raise StateMismatchError(f"{name} {wrong}")
        if not state.is_coherent():
            raise StateMismatchError("its parts do not belong together")


def _check_texts(record: NDArray[Any]) -> None:
    """Reject invalid code points: numpy raises SystemError when it converts them to str."""
    for name in record.dtype.names or ():
        kind = record.dtype[name].base
        if kind.kind == "U":
            codes = np.atleast_1d(record[name]).view(
                np.dtype(np.uint32).newbyteorder(kind.byteorder)
            )
            if codes.max(initial=0) > sys.maxunicode:
                raise ValueError(f"{name} is no text")


_MAGIC = b"\x93NUMPY\x01\x00"
_HEADER_BYTES = 4_096  # numpy parses a header as Python; ours have at most half of that

_UNREADABLE = (  # exceptions on bytes that are no record of arrays
    *(ValueError, TypeError, KeyError, IndexError, OverflowError, MemoryError),
    *(SyntaxError, RecursionError, UnicodeError, struct.error),
)

S = TypeVar("S", bound=State)


class Estimator(Protocol[S]):
    """A frozen dataclass of hyper-parameters with pure methods that take and return the state.

    Invariants of every estimator: no method changes its arguments. The result does not depend on
    the batching of a stream, bit by bit. For any samples (NaN, inf, 1e308, zeros), no exception is
    raised, no warning is issued, and the state stays finite and of constant size. Samples whose
    quality is BAD or that are not finite do not change the state.
    """

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of theta's elements, as published."""

    def initial_state(self) -> S:
        """State before the first sample."""

    def update(self, state: S, samples: Samples) -> tuple[S, Trace]:
        """Update with N samples in sequence."""

    def predict(self, state: S, U: Floats, dp: Floats, T: Floats) -> tuple[Floats, Floats]:
        """Flow Q̂ (N,) and its standard deviation (N,), l/min, at N points; NaN if unknown."""

    def parameters(self, state: S) -> tuple[Floats, Floats]:
        """Theta (n,) in physical units and its standard deviations (n,); NaN if unknown."""

    def adaptation(self, state: S) -> Adaptation:
        """Return the assessment of the recent residuals."""


def key_of(estimator: object) -> str:
    """Hash of an estimator's hyper-parameters, to which its states and checkpoints are bound."""
    assert hasattr(estimator, "__dataclass_fields__")  # noqa: S101 - a programmer's mistake
    return _key_of(_ByText(estimator))


class _ByText:
    """A dataclass that equals another one of the same text: 1 and 1.0 give two keys."""

    def __init__(self, one: object) -> None:
        self.one = one
        self._text = type(one), repr(one)

    def __hash__(self) -> int:
        return hash(self._text)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _ByText) and self._text == other._text


@lru_cache(maxsize=256)
def _key_of(estimator: _ByText) -> str:
    """Return the hash; cached: it takes ten times as long as the text."""
    one = estimator.one
    text = json.dumps(
        {"type": type(one).__name__, **asdict(one)},  # type: ignore[call-overload]
        sort_keys=True,
        default=repr,
    )
    return hashlib.sha256(text.encode()).hexdigest()
