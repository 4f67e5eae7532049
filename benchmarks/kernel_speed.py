"""How fast an update is beside C and other packages: ``python -m benchmarks.kernel_speed``.

Five terms, arrays in, one core, CPU time, the best of several rounds of all in turn. The peers are
``rls.c`` (compiled on the spot with -O3, where there is a gcc) and padasip, river, filterpy where
installed. Ours keeps factors, a covariance of theta and, by default, watches for changes.
"""

import ctypes
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks import peers
from valvemap.model.estimator import Estimator
from valvemap.model.fleet import learn_many, stack
from valvemap.model.forgetting import Adaptive, Exponential, Forgetting
from valvemap.model.least_squares_of_arrays import recursive_least_squares
from valvemap.model.maximum_likelihood import MaximumLikelihood
from valvemap.model.model_structures import FiveTerms
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Floats, Samples, Segments

N, PEER_N, MODELS, PASSES, ROUNDS = 200_000, 2_000, 10_000, 20, 7
LAM = 0.998
SIZES = 5, 9, 20, 63
SOURCE = Path(__file__).with_name("rls.c")

Figures = dict[str, float]


def one_model() -> Figures:
    """Time per update, ns, of the recursion alone: rows of X in, theta and innovations out."""
    X, y = _problem(N)
    few = X[:PEER_N], y[:PEER_N]
    jobs: dict[str, tuple[Callable[[], object], int]] = {
        f"ours, {rule}": (lambda r=rule: recursive_least_squares(X, y, r), N)
        for rule in (Adaptive(), Exponential(LAM))
    }
    library = _compiled()
    if library is not None:
        jobs["C -O3"] = (lambda: _c_plain(library, X, y), N)
        jobs["C -O3, the same algorithm"] = (lambda: _c_factors(library, X, y), N)
    for name in peers.installed():
        if name in peers.FOLLOWERS:
            jobs[name] = (lambda f=peers.FOLLOWERS[name]: f(*few, LAM), PEER_N)
    return _nanoseconds(jobs)


def model_sizes() -> Figures:
    """Time per update, ns, by the number of parameters, and how many times that of C.

    C is `rls_ud`, the same algorithm, with exponential forgetting; beside it the plain recursion,
    whose P may become indefinite, and ours with its default, which watches for changes, too.
    """
    found: Figures = {}
    for n in SIZES:
        rng = np.random.default_rng(0)
        X = rng.normal(size=(N // 4, n))
        y = X.sum(axis=1) + rng.normal(size=len(X))
        jobs: dict[str, tuple[Callable[[], object], int]] = {
            name: (lambda r=rule: recursive_least_squares(X, y, r), len(X))  # noqa: B023 - now
            for name, rule in (("ours", Exponential(LAM)), ("ours, default", Adaptive()))
        }
        library = _compiled()
        if library is not None:
            jobs["C -O3"] = (lambda: _c_factors(library, X, y), len(X))  # noqa: B023 - now
            jobs["C -O3, plain"] = (lambda: _c_plain(library, X, y), len(X))  # noqa: B023 - now
        figures = _nanoseconds(jobs)
        found |= {f"n = {n}: {name}": ns for name, ns in figures.items()}
        if library is not None:
            found[f"n = {n}: ours over C"] = figures["ours"] / figures["C -O3"]
    return found


def whole_estimators() -> Figures:
    """Time per sample, ns, of the estimators as the service runs them: signals in, trace out."""
    samples = _samples(N)
    estimators: dict[str, Estimator] = {
        "RLS": RecursiveLeastSquares(forgetting=Adaptive()),
        "RML": MaximumLikelihood(),
        "RBF": RbfNetwork(),
    }
    jobs: dict[str, tuple[Callable[[], object], int]] = {
        name: (lambda e=e: e.update(e.initial_state(), samples), N)
        for name, e in estimators.items()
    }
    return _nanoseconds(jobs)


def many_models(rule: Forgetting) -> Figures:
    """Time per update, ns, of 10,000 models that get a sample each, again and again."""
    X, y = _problem(MODELS * PASSES)
    rls = RecursiveLeastSquares(forgetting=rule)
    warm, _ = rls.update(rls.initial_state(), _samples(200))
    fleet = stack([warm] * MODELS)
    rows, usable = np.arange(MODELS), np.ones(MODELS, np.uint8)
    segments = Segments(rows, rows, rows + 1)
    parts = [slice(k * MODELS, (k + 1) * MODELS) for k in range(PASSES)]
    t = np.arange(MODELS)

    def ours() -> None:
        for part in parts:
            learn_many(fleet, rule, X[part], y[part], t, usable, segments)

    jobs: dict[str, tuple[Callable[[], object], int]] = {"ours": (ours, MODELS * PASSES)}
    library = _compiled()
    if library is not None:
        columns = [np.ascontiguousarray(X[part].T) for part in parts]
        outputs = [y[part] for part in parts]
        jobs["C -O3, structure of arrays"] = (
            lambda: _c_fleet(library, columns, outputs),
            MODELS * PASSES,
        )
    return _nanoseconds(jobs)


def compared() -> dict[str, Figures]:
    """Ours, first, and others."""
    return {
        "One model, n = 5, ns per update": one_model(),
        "Estimators as the service runs them, ns per sample": whole_estimators(),
        "10,000 models, default forgetting, ns": many_models(Adaptive()),
        "10,000 models, exponential, ns": many_models(Exponential(LAM)),
    }


def main() -> int:
    """Measure and print."""
    for title, figures in (compared() | {"by the number of parameters": model_sizes()}).items():
        print(title)
        slowest = max(map(len, figures))
        first = next(iter(figures.values()))
        for name, ns in figures.items():
            print(f"  {name:{slowest}}  {ns:10.1f} ns  {ns / first:8.2f} x the first")
    return 0


def _problem(n: int) -> tuple[Floats, Floats]:
    samples = _samples(n)
    return FiveTerms().regressors(samples.U, samples.dp, samples.T), samples.Q


def _samples(n: int) -> Samples:
    rng = np.random.default_rng(0)
    U, dp = rng.uniform(0, 100, n), rng.uniform(1, 200, n)
    Q = 1.0 + 0.02 * U + 0.3 * np.sqrt(dp) + 0.12 * U * np.sqrt(dp) + rng.normal(size=n)
    return Samples.of(np.arange(n), U, np.full(n, 200.0), 200.0 - dp, Q, np.full(n, 40.0))


def _nanoseconds(jobs: dict[str, tuple[Callable[[], object], int]]) -> Figures:
    """CPU time per item: the best of rounds in which all take turns, so that all fare alike."""
    for work, _ in jobs.values():
        work()
    best = dict.fromkeys(jobs, np.inf)
    for _ in range(ROUNDS):
        for name, (work, items) in jobs.items():
            start = time.process_time()
            work()
            best[name] = min(best[name], (time.process_time() - start) / items * 1e9)
    return best


@cache
def _compiled() -> ctypes.CDLL | None:
    """``rls.c`` as a library; None where there is no gcc."""
    gcc = shutil.which("gcc")
    if gcc is None:
        return None
    library = Path(tempfile.mkdtemp()) / "rls.so"
    command = [gcc, "-O3", "-shared", "-fPIC", "-o", str(library), str(SOURCE)]
    subprocess.run(command, check=True)
    return ctypes.CDLL(str(library))


def _pointer(array: Floats) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def _c_plain(library: ctypes.CDLL, X: Floats, y: Floats) -> Floats:
    n = X.shape[1]
    theta, P, e = np.zeros(n), 1e8 * np.eye(n), np.empty(len(y))
    samples = n, ctypes.c_long(len(y)), *map(_pointer, (X, y)), ctypes.c_double(LAM)
    library.rls(*samples, *map(_pointer, (theta, P, e)))
    return theta


def _c_factors(library: ctypes.CDLL, X: Floats, y: Floats) -> Floats:
    n = X.shape[1]
    theta, U, e = np.zeros(n), 1e8 * np.eye(n)[np.tril_indices(n)], np.empty(len(y))
    S = np.zeros_like(U)
    samples = n, ctypes.c_long(len(y)), *map(_pointer, (X, y)), ctypes.c_double(LAM)
    library.rls_ud(*samples, *map(_pointer, (theta, U, S, e)))
    return theta


def _c_fleet(library: ctypes.CDLL, columns: list[Floats], outputs: list[Floats]) -> Floats:
    n, M = columns[0].shape
    theta, P = np.zeros((n, M)), np.tile(1e8 * np.eye(n)[:, :, None], (1, 1, M))
    work = np.empty((n, M)), np.empty(M), np.empty(M)
    for X, y in zip(columns, outputs, strict=True):
        arrays = map(_pointer, (X, y))
        rest = map(_pointer, (theta, P, *work))
        library.rls_fleet(n, ctypes.c_long(M), *arrays, ctypes.c_double(LAM), *rest)
    return theta


if __name__ == "__main__":
    sys.exit(main())
