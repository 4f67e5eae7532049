"""C99 of an FMI 2.0 co-simulation unit: interpolation in the tables, and their intervals."""

from typing import Final

TABLE_CALLS: Final = r"""
static double valvemap_between(const double *table, int columns, int i, int j, double u, double v)
{
    const double *at = table + i * columns + j;
    return (1.0 - u) * ((1.0 - v) * at[0] + v * at[1])
         + u * ((1.0 - v) * at[columns] + v * at[columns + 1]);
}

static double valvemap_limited(double x, double low, double high)
{
    return x < low ? low : x > high ? high : x;
}

/* 95 % interval of the required U: where no U can be trusted, all of 0 ... 100 %. */
static void valvemap_U_interval(double Q, double dp, int status, double U, double *bounds)
{
    int i, j;
    double low, high, u, v, r;
    bounds[0] = 0.0;
    bounds[1] = 100.0;
    if (status == VALVEMAP_NOT_FINITE || status == VALVEMAP_UNIDENTIFIED)
        return;
    dp = valvemap_limited(dp, valvemap_dp[0], valvemap_dp[VALVEMAP_N_DP - 1]);
    j = valvemap_place(valvemap_dp, VALVEMAP_N_DP, dp);
    v = (dp - valvemap_dp[j]) / (valvemap_dp[j + 1] - valvemap_dp[j]);
    low = (1.0 - v) * valvemap_lowest[j] + v * valvemap_lowest[j + 1];
    high = (1.0 - v) * valvemap_highest[j] + v * valvemap_highest[j + 1];
    if (!(high > low))
        return;
    r = valvemap_limited((Q - low) / (high - low), 0.0, 1.0);
    i = valvemap_place(valvemap_r, VALVEMAP_N_R, r);
    u = (r - valvemap_r[i]) / (valvemap_r[i + 1] - valvemap_r[i]);
    low = valvemap_between(&valvemap_lower[0][0], VALVEMAP_N_DP, i, j, u, v);
    high = valvemap_between(&valvemap_upper[0][0], VALVEMAP_N_DP, i, j, u, v);
    bounds[0] = low < U ? low : U;
    bounds[1] = high > U ? high : U;
}

/* Flow at U and dp with the 95 % interval of a new measurement. Outside the axes the nearest point
 * is taken, and the status is OUTSIDE; with NOT_FINITE the outputs are left as they were. */
static int valvemap_flow(double U, double dp, double *Q, double *lower, double *upper)
{
    int status = VALVEMAP_OK, i, j;
    double s, at_U, at_s, u, v, half;
    if (!valvemap_is_finite(U) || !valvemap_is_finite(dp))
        return VALVEMAP_NOT_FINITE;
    s = sqrt(dp > 0.0 ? dp : 0.0);
    at_U = valvemap_limited(U, valvemap_axis_U[0], valvemap_axis_U[VALVEMAP_N_U - 1]);
    at_s = valvemap_limited(s, valvemap_axis_s[0], valvemap_axis_s[VALVEMAP_N_S - 1]);
    i = valvemap_place(valvemap_axis_U, VALVEMAP_N_U, at_U);
    j = valvemap_place(valvemap_axis_s, VALVEMAP_N_S, at_s);
    u = (at_U - valvemap_axis_U[i]) / (valvemap_axis_U[i + 1] - valvemap_axis_U[i]);
    v = (at_s - valvemap_axis_s[j]) / (valvemap_axis_s[j + 1] - valvemap_axis_s[j]);
    if (at_U != U || at_s != s || dp < 0.0)
        status = VALVEMAP_OUTSIDE;
    else if (valvemap_flow_guess[i][j] || valvemap_flow_guess[i][j + 1]
             || valvemap_flow_guess[i + 1][j] || valvemap_flow_guess[i + 1][j + 1])
        status = VALVEMAP_EXTRAPOLATING;
    *Q = valvemap_between(&valvemap_Q[0][0], VALVEMAP_N_S, i, j, u, v);
    half = valvemap_between(&valvemap_half[0][0], VALVEMAP_N_S, i, j, u, v);
    *lower = *Q - half;
    *upper = *Q + half;
    return status;
}
"""
