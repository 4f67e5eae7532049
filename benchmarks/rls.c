/* Plain recursive least squares with forgetting, eq. (28): what a C programmer would write.
 * rls: one model, N samples. rls_fleet: M models as a structure of arrays, one sample each.
 * rls_ud: the algorithm of the service: Bierman's factors P = U*D*U', which stay symmetric and
 * positive, and S = sum lam^(2(N-i)) x*x', by which P*S*P is the covariance of theta. */

#define MOST 64

void rls(int n, long N, const double *X, const double *y, double lam, double *theta, double *P,
         double *innovations)
{
    double Ph[MOST];
    for (long t = 0; t < N; t++) {
        const double *x = X + t * n;
        double r = lam, e = y[t];
        for (int i = 0; i < n; i++) {
            double sum = 0.0;
            for (int j = 0; j < n; j++)
                sum += P[i * n + j] * x[j];
            Ph[i] = sum;
            r += x[i] * sum;
            e -= x[i] * theta[i];
        }
        innovations[t] = e;
        for (int i = 0; i < n; i++) {
            double gain = Ph[i] / r;
            theta[i] += gain * e;
            for (int j = 0; j < n; j++)
                P[i * n + j] = (P[i * n + j] - gain * Ph[j]) / lam;
        }
    }
}

/* X[n][M], y[M], theta[n][M], P[n][n][M] */
void rls_fleet(int n, long M, const double *X, const double *y, double lam, double *theta,
               double *P, double *Ph, double *r, double *e)
{
    for (long m = 0; m < M; m++) {
        r[m] = lam;
        e[m] = y[m];
    }
    for (int i = 0; i < n; i++) {
        for (long m = 0; m < M; m++)
            Ph[i * M + m] = 0.0;
        for (int j = 0; j < n; j++)
            for (long m = 0; m < M; m++)
                Ph[i * M + m] += P[(i * n + j) * M + m] * X[j * M + m];
        for (long m = 0; m < M; m++) {
            r[m] += X[i * M + m] * Ph[i * M + m];
            e[m] -= X[i * M + m] * theta[i * M + m];
        }
    }
    for (int i = 0; i < n; i++) {
        for (long m = 0; m < M; m++)
            theta[i * M + m] += Ph[i * M + m] / r[m] * e[m];
        for (int j = 0; j < n; j++)
            for (long m = 0; m < M; m++)
                P[(i * n + j) * M + m] =
                    (P[(i * n + j) * M + m] - Ph[i * M + m] / r[m] * Ph[j * M + m]) / lam;
    }
}

/* U[j*(j+1)/2 + i] holds U[i][j] for i < j, then D[j]; S alike. */
void rls_ud(int n, long N, const double *X, const double *y, double lam, double *theta, double *U,
            double *S, double *innovations)
{
    double f[MOST], Px[MOST];
    for (long t = 0; t < N; t++) {
        const double *x = X + t * n;
        double alpha = lam, e = y[t];
        for (int j = 0; j < n; j++) {
            const double *row = U + j * (j + 1) / 2;
            double sum = x[j];
            for (int i = 0; i < j; i++)
                sum += row[i] * x[i];
            f[j] = sum;
            e -= x[j] * theta[j];
        }
        innovations[t] = e;
        for (int j = 0; j < n; j++) {
            double *row = U + j * (j + 1) / 2;
            double v = row[j] * f[j], step = -f[j] / alpha, next = alpha + f[j] * v;
            row[j] *= alpha / next / lam;
            alpha = next;
            for (int i = 0; i < j; i++) {
                double u = row[i];
                row[i] = u + step * Px[i];
                Px[i] += u * v;
            }
            Px[j] = v;
        }
        for (int j = 0; j < n; j++) {
            double *row = S + j * (j + 1) / 2;
            for (int i = 0; i <= j; i++)
                row[i] = lam * lam * row[i] + x[j] * x[i];
            theta[j] += Px[j] / alpha * e;
        }
    }
}
