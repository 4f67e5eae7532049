"""Healthy axes that are watched for sudden changes: none is followed, and the map is as good.

``python -m benchmarks.axis_changes [--seeds 2] [--first 601]``: one table. Each seed is an axis as
of ``benchmarks.axis``; the first 150 s are searched for play and spool, the next 750 s are learnt
once with changes expected and once without. Errors are over all visited cells, in σ.
"""

import argparse
from dataclasses import replace

import numpy as np

from benchmarks.axis import GEOMETRY, NOISES_MM, SIGMA, errors, machine, played, samples
from valvemap.model.axis_fit import fit, moved, with_map
from valvemap.model.axis_search import identify
from valvemap.pipeline.axis_learner import CHANGES_PER_S

SEARCHED, ALL, BATCH, FITTED_AGAIN = 15_000, 90_000, 500, 5_000  # samples


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first", type=int, default=601)
    options = parser.parse_args()
    for seed in range(options.first, options.first + options.seeds):
        noise_mm = NOISES_MM[seed % 3]
        axis = machine(seed, noise_mm)
        block = played(axis, seed, 0.01 * ALL)
        recorded = samples(block)
        found = identify(recorded[:SEARCHED], GEOMETRY, memory_s=1_800.0)
        if found.fit is None or found.state is None or found.of_shape is None:
            print(seed, found.sentence)
            continue
        plain = found.fit.regression
        follows = replace(plain, changes_per_s=CHANGES_PER_S)
        living = without = with_map(found.state, found.fit)
        changed = 0
        for start in range(SEARCHED, ALL, BATCH):
            part = recorded[start : start + BATCH]
            living, _ = follows.update(living, part)
            without, _ = plain.update(without, part)
            changed += living.has_changed
            if start % FITTED_AGAIN == 0:
                one = fit(follows, living)
                of_shape = found.of_shape
                living = with_map(living, replace(one, covariance=one.covariance + of_shape))
        maps = moved(fit(follows, living), living), fit(plain, without)
        off = [float(np.sqrt(np.mean(errors(axis, block, one)[0] ** 2)) / SIGMA) for one in maps]
        gain, shift = np.abs(living.drift_now[:, 0, :2]).max(axis=0)
        print(
            f"{seed} {noise_mm:5.3f} mm: batches after a change {changed}, largest gain "
            f"{100 * gain:.2f} %, shift {shift:.3f} %; error {off[0]:.3f} σ, "
            f"without {off[1]:.3f} σ",
            flush=True,
        )


if __name__ == "__main__":
    main()
