/* What errpipe's Numba batch is measured against: the same volumetric table in plain C, point by point and by blocks. */
#include <stdint.h>

#define BLOCK 512

typedef struct {
    double start, inverse_step, scale, factor;
    const double *knots; /* value and rise to the next, alternating */
    int32_t axis, last, component, same_grid;
} curve;

typedef struct {
    double weight;
    int32_t output, component, axis; /* axis -1: no arm */
} term;

void by_point(const curve *curves, int n_curves, const term *terms, int n_terms, const double *fixed, int n_components,
              const double *points, long n, double *out)
{
    long i;
    for (i = 0; i < n; i++) {
        double sums[64], total[3] = {0.0, 0.0, 0.0}, f = 0.0;
        int64_t j = 0;
        int c, k;
        for (k = 0; k < n_components; k++) {
            sums[k] = fixed[k];
        }
        for (c = 0; c < n_curves; c++) {
            const curve *p = &curves[c];
            if (!p->same_grid) {
                double s = (points[p->axis * n + i] - p->start) * p->inverse_step;
                s = s > 0.0 ? s : 0.0;
                s = s < (double)p->last ? s : (double)p->last;
                j = (int64_t)s;
                j = j < p->last - 1 ? j : p->last - 1;
                f = s - (double)j;
            }
            sums[p->component] += (p->knots[2 * j] + f * p->knots[2 * j + 1]) * p->scale * p->factor;
        }
        for (k = 0; k < n_terms; k++) {
            double part = terms[k].weight * sums[terms[k].component];
            if (terms[k].axis >= 0) {
                part = part * points[terms[k].axis * n + i];
            }
            total[terms[k].output] += part;
        }
        out[i] = total[0];
        out[n + i] = total[1];
        out[2 * n + i] = total[2];
    }
}

void by_block(const curve *curves, int n_curves, const term *terms, int n_terms, const double *fixed, int n_components,
              const double *points, long n, double *out)
{
    static double sums[64][BLOCK], f[BLOCK], total[3][BLOCK];
    static int64_t j[BLOCK];
    long begin, i;
    for (begin = 0; begin < n; begin += BLOCK) {
        long count = n - begin < BLOCK ? n - begin : BLOCK;
        int c, k, o;
        for (k = 0; k < n_components; k++) {
            for (i = 0; i < BLOCK; i++) {
                sums[k][i] = fixed[k];
            }
        }
        for (c = 0; c < n_curves; c++) {
            const curve *p = &curves[c];
            const double *x = points + p->axis * n + begin;
            double *sum = sums[p->component];
            if (!p->same_grid) {
                for (i = 0; i < count; i++) {
                    double s = (x[i] - p->start) * p->inverse_step;
                    s = s > 0.0 ? s : 0.0;
                    s = s < (double)p->last ? s : (double)p->last;
                    int64_t own = (int64_t)s;
                    own = own < p->last - 1 ? own : p->last - 1;
                    f[i] = s - (double)own;
                    j[i] = 2 * own;
                }
            }
            for (i = 0; i < count; i++) {
                sum[i] += (p->knots[j[i]] + f[i] * p->knots[j[i] + 1]) * p->scale * p->factor;
            }
        }
        for (o = 0; o < 3; o++) {
            for (i = 0; i < BLOCK; i++) {
                total[o][i] = 0.0;
            }
        }
        for (k = 0; k < n_terms; k++) {
            const term *t = &terms[k];
            const double *sum = sums[t->component];
            double *to = total[t->output];
            if (t->axis < 0) {
                for (i = 0; i < count; i++) {
                    to[i] += t->weight * sum[i];
                }
            } else {
                const double *arm = points + t->axis * n + begin;
                for (i = 0; i < count; i++) {
                    to[i] += t->weight * sum[i] * arm[i];
                }
            }
        }
        for (o = 0; o < 3; o++) {
            for (i = 0; i < count; i++) {
                out[o * n + begin + i] = total[o][i];
            }
        }
    }
}
