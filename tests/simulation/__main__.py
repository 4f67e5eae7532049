"""Run many seeds, or one: ``python -m simulation --seeds N [--first N] | --seed N``."""

import argparse
import gc
import sys
import time

from simulation.draws import draw
from simulation.world import simulate


def main():
    parser = argparse.ArgumentParser(prog="simulation")
    parser.add_argument("--seeds", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int)
    chosen = parser.parse_args()
    if chosen.seed is not None:
        outcome = simulate(chosen.seed)
        print(draw(chosen.seed))
        print(f"seed {chosen.seed}: trace {outcome.trace}, {dict(outcome.counts)}")
        print("\n".join(outcome.violations) or "no violation")
        return bool(outcome.violations)
    simulate(chosen.first)  # loads the kernels
    gc.freeze()
    gc.set_threshold(100_000)  # else a twentieth of the time is spent on what stays anyway
    began, failed, counts = time.process_time(), 0, None
    for seed in range(chosen.first, chosen.first + chosen.seeds):
        outcome = simulate(seed)
        counts = outcome.counts if counts is None else counts + outcome.counts
        failed += bool(outcome.violations)
        for sentence in outcome.violations[:1]:
            print(f"seed {seed}: {sentence}", flush=True)
    took_s = time.process_time() - began
    pace = 60.0 * chosen.seeds / took_s
    print(f"{chosen.seeds} seeds, {failed} with violations, {pace:.0f} a minute of one core")
    print(dict(counts))
    return failed > 0


if __name__ == "__main__":
    sys.exit(main())
