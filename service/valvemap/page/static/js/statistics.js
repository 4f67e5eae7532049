// What residuals look like: their spread, and whether they follow one another. Pure.

/** Share of values in each of `bins` equal bins from -limit to limit; the outer ones take the rest. */
export function histogram(values, limit, bins) {
  const counts = new Array(bins).fill(0);
  for (const value of values) {
    const k = Math.floor(((value + limit) / (2 * limit)) * bins);
    counts[Math.min(Math.max(k, 0), bins - 1)] += 1;
  }
  return counts.map((count) => count / Math.max(values.length, 1));
}

/** Autocorrelation at lags 1 … lags. */
export function autocorrelation(values, lags) {
  const n = values.length, mean = values.reduce((a, b) => a + b, 0) / n;
  const centred = values.map((value) => value - mean);
  const power = centred.reduce((sum, value) => sum + value * value, 0);
  return Array.from({ length: lags }, (_, k) => {
    let sum = 0;
    for (let i = k + 1; i < n; i++) sum += centred[i] * centred[i - k - 1];
    return power > 0 ? sum / power : 0;
  });
}

/** 95 % of the autocorrelations of n independent values lie within ± this. */
export const whiteBound = (n) => 1.96 / Math.sqrt(Math.max(n, 1));

export function quantile(values, share) {
  const sorted = Float64Array.from(values).sort();
  return sorted.length ? sorted[Math.min(Math.floor(share * sorted.length), sorted.length - 1)] : NaN;
}
