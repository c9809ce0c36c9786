/* Functions of programs of one run: calls to the C library save all registers and take longer. */
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>
const int64_t width = 1;

/* powers of two to multiples of 1 / ${points}, and their relative rounding errors */
static const double POWERS[${points}][2] = {${powers}};

static __attribute__((noinline, const)) double exp_of(double x)
{
    const double shifted = x * ${per_power} + ${magic}, n = shifted - ${magic};
    const double r = (x - n * ${power_high}) - n * ${power_low};
    int64_t whole, bits;
    memcpy(&whole, &shifted, sizeof whole);
    const double *power = POWERS[whole & (${points} - 1)];
    const double rest = (power[1] + r) + r * r * ${exp};
    double y = power[0] + power[0] * rest;
    memcpy(&bits, &y, sizeof bits);
    bits += (whole >> ${point_bits}) << ${mantissa_bits};
    memcpy(&y, &bits, sizeof y);
    return x < ${lowest_exp} ? 0.0 : x > ${highest_exp} ? INFINITY : y;
}

static __attribute__((noinline, const)) double tanh_of(double x)
{
    const double y = exp_of(-2 * fabs(x));
    return copysign((1 - y) / (1 + y), x);
}

static __attribute__((noinline, const)) double _Complex sincos_of(double x)
{
    const double shifted = x * ${per_quadrant} + ${magic}, n = shifted - ${magic};
    const double r = (x - n * ${quadrant_high}) - n * ${quadrant_low}, z = r * r;
    const double sine = r + r * z * ${sin};
    const double cosine = 1 - (z / 2 - z * z * ${cos});
    int64_t quadrant;
    memcpy(&quadrant, &shifted, sizeof quadrant);
    if ((quadrant & 3) == 0) return __builtin_complex(sine, cosine);
    const double a = quadrant & 1 ? cosine : sine, b = quadrant & 1 ? sine : cosine;
    return __builtin_complex(quadrant & 2 ? -a : a, (quadrant + 1) & 2 ? -b : b);
}

static inline double sin_of(double x) { return __real__ sincos_of(x); }
static inline double cos_of(double x) { return __imag__ sincos_of(x); }
