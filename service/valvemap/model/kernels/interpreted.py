"""Kernels that run interpreted, as long as they are not compiled or where there is no numba.

Compiling all kernels takes most of a minute. A command that starts without a cache of them can run
them as plain Python meanwhile (`begin`), while other processes compile: some hundred times slower,
but fast enough for a few hundred samples per second. After `end`, each kernel is loaded or
compiled at its next call. A command that computes a few numbers is done before numba is even
imported: there each kernel is a `Plain` function.

A compiled kernel is called as before: numba asks a dispatcher for code only if it has none for the
arguments. Private part of numba: a dispatcher's ``_compile_for_args``.

Interpreted kernels follow IEEE arithmetic like compiled ones: 1/0 is inf and sqrt(-1) is NaN. They
may differ in the last bits where Python computes in single precision.
"""

import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, wraps
from types import FunctionType, SimpleNamespace
from typing import Any, Final

import numpy as np

from valvemap.model.kernels.prefetch import fetch

Function = Callable[..., Any]


class Plain:
    """A kernel without numba: it has the function, and runs it interpreted."""

    def __init__(self, function: Function) -> None:
        self.py_func: Any = function
        self.__doc__ = function.__doc__

    def __call__(self, *args: object, **kws: object) -> Any:  # noqa: ANN401
        """Return the function's result."""
        return _called(self.py_func)(*args, **kws)


def begin() -> None:
    """From now on, run kernels without compiled code interpreted."""
    _state.is_on = True


def end() -> None:
    """From now on, compile kernels again, or load them from the cache."""
    _state.is_on = False


@contextmanager
def compiling() -> Iterator[None]:
    """Compile kernels, or load them from the cache, in this thread; others do not wait for it."""
    _thread.compiles = True
    try:
        yield
    finally:
        _thread.compiles = False


def is_on() -> bool:
    """Whether kernels without compiled code run interpreted."""
    return bool(_state.is_on)


def interpretable(dispatcher: Any) -> None:  # noqa: ANN401 - numba has no types
    """Let `begin` and `end` affect a compiled function."""
    compile_for = dispatcher._compile_for_args  # noqa: SLF001

    def code_for(*args: object, **kws: object) -> Any:  # noqa: ANN401
        if _state.is_on and not getattr(_thread, "compiles", False):
            return _called(dispatcher.py_func)
        return compile_for(*args, **kws)

    dispatcher._compile_for_args = code_for  # noqa: SLF001


@cache
def _called(function: FunctionType) -> Function:
    """Return a kernel as plain Python that is called with Python's numbers."""
    plain = _plain(function)

    def call(*args: object, **kws: object) -> Any:  # noqa: ANN401
        with np.errstate(all="ignore"):
            return plain(*map(_number, args), **{name: _number(x) for name, x in kws.items()})

    return call


@cache
def _plain(function: FunctionType) -> FunctionType:
    """Return a function that calls kernels as plain Python functions."""
    scope = _scope(function.__globals__)
    plain = FunctionType(function.__code__, scope, function.__name__, None, function.__closure__)
    plain.__defaults__, plain.__kwdefaults__ = function.__defaults__, function.__kwdefaults__
    return plain


def _scope(names: dict[str, Any]) -> dict[str, Any]:
    """Return the global names of a module, without kernels; one for all of its functions."""
    if id(names) not in _scopes:
        scope: dict[str, Any] = {}
        _scopes[id(names)] = scope  # before it is filled: kernels may call each other
        scope |= {name: _replaced(value) for name, value in names.items()}
    return _scopes[id(names)]


def _replaced(value: Any) -> Any:  # noqa: ANN401
    if hasattr(value, "py_func"):
        return _plain(value.py_func)
    if value is fetch:
        return _nothing  # a hint for the processor
    if value is math:
        return _MATH
    return value


def _ieee(name: str) -> Function:
    """Return a function of `math` that has a value where Python's raises."""
    of, otherwise = getattr(math, name), getattr(np, _NUMPY.get(name, name))

    @wraps(of)
    def value(*args: float) -> Any:  # noqa: ANN401
        try:
            return np.float64(of(*args))
        except (ValueError, OverflowError):
            return otherwise(*map(np.float64, args))

    return value


def _number(x: Any) -> Any:  # noqa: ANN401
    return np.float64(x) if type(x) is float else x


def _nothing(*_: object) -> None:
    pass


_NUMPY: Final = {"pow": "power"}
_RAISES: Final = "sqrt", "log", "log10", "log1p", "exp", "expm1", "pow"
_MATH: Final = SimpleNamespace(**{**vars(math), **{name: _ieee(name) for name in _RAISES}})
_scopes: Final[dict[int, dict[str, Any]]] = {}
_thread: Final = threading.local()
_state: Final = SimpleNamespace(is_on=False)
