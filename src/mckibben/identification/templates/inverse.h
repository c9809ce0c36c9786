/* Inverse table of a muscle at constant loads, by mckibben ${version}: the pressure over contraction and load.
   Error at held-out points: ${rmse} Pa (RMSE). */
#ifndef INVERSE_H
#define INVERSE_H
#include <math.h>

#define INVERSE_LOADS ${loads|length}
static const double inverse_loads[INVERSE_LOADS] = {${loads|join(", ")}}; /* [N], ascending */
/* First point of the curve of each load in shortening and in lengthening, and the number of points. */
static const int inverse_start[2 * INVERSE_LOADS + 1] = {${starts|join(", ")}};
static const double inverse_contraction[] = {${contraction|join(", ")}};
static const double inverse_pressure[] = {${pressure|join(", ")}}; /* gauge [Pa] */

/* Gauge pressure [Pa] of a curve at a contraction [-]; NAN beyond its ends. */
static double inverse_along(int load, int lengthening, double contraction)
{
    int low = inverse_start[2 * load + lengthening], high = inverse_start[2 * load + lengthening + 1] - 1;
    if (high < low || !(contraction >= inverse_contraction[low] && contraction <= inverse_contraction[high])) {
        return NAN;
    }
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        if (contraction < inverse_contraction[middle]) {
            high = middle;
        } else {
            low = middle;
        }
    }
    const double width = inverse_contraction[high] - inverse_contraction[low];
    const double share = width > 0 ? (contraction - inverse_contraction[low]) / width : 0.0;
    return (1 - share) * inverse_pressure[low] + share * inverse_pressure[high];
}

/* Gauge pressure [Pa] at a contraction [-] and a load [N], reached by shortening (0) or lengthening (1); NAN where
   nothing was measured. */
static double inverse_pressure_for(double contraction, double load, int lengthening)
{
    for (int i = 0; i < INVERSE_LOADS; i++) {
        if (load == inverse_loads[i]) {
            return inverse_along(i, lengthening, contraction);
        }
        if (i > 0 && load > inverse_loads[i - 1] && load < inverse_loads[i]) {
            const double share = (load - inverse_loads[i - 1]) / (inverse_loads[i] - inverse_loads[i - 1]);
            return (1 - share) * inverse_along(i - 1, lengthening, contraction)
                + share * inverse_along(i, lengthening, contraction);
        }
    }
    return NAN;
}

#endif
