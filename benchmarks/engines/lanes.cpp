// The reference episode for many lanes at once, in SIMD by hand: about as fast as a core can run it.
//
// GCC/Clang vector extensions; a bundle of WIDTH lanes takes every step together. exp and sincos are polynomials after a
// Cody-Waite reduction (coefficients of mckibben.numerics.elementary). What a compiler may not do by itself is done here:
// divisions by constants are products, one division serves a muscle, sin(hanging - angle) comes from that of the angle.
#include <cstdint>
#include <cstring>

#ifndef REAL
#define REAL double
#endif
#ifndef BYTES
#define BYTES 64  // of a bundle: one AVX-512 register, or several smaller ones
#endif

using real = REAL;
constexpr bool SINGLE = sizeof(real) == 4;
template <bool single> struct Bits { using type = int64_t; };
template <> struct Bits<true> { using type = int32_t; };
using bits = Bits<SINGLE>::type;
constexpr int WIDTH = BYTES / sizeof(real);
typedef real Lanes __attribute__((vector_size(BYTES)));
typedef bits Whole __attribute__((vector_size(BYTES)));

struct Parameters {  // that of knee.h
    real a1, a2, b1, b2, c1, c2, decay, l0, H, r, connector, inertia, damping, gravity, hanging, time_constant, low, high;
    real kp[2], ki[2], kd[2], filter[2], tracking[2];
};
struct Run {
    const real *wanted_angle, *wanted_stiffness;
    real start[4];
    long periods, substeps;
    real period;
};

static inline Lanes all(real x) { return x - Lanes{}; }
static inline Lanes larger(Lanes x, Lanes y) { return x > y ? x : y; }
static inline Lanes clip(Lanes x, real low, real high) {
    x = x < low ? all(low) : x;
    return x > high ? all(high) : x;
}

static inline Lanes root(Lanes x) {
    Lanes y;
    for (int i = 0; i < WIDTH; i++) y[i] = SINGLE ? __builtin_sqrtf(x[i]) : __builtin_sqrt(x[i]);
    return y;
}

// Adding it rounds to a whole number, which is then in the low bits.
constexpr real MAGIC = SINGLE ? real(12582912.0) : real(6755399441055744.0);
static inline Whole low_bits(Lanes x) { return (Whole)x; }

// A polynomial, highest coefficient first.
template <class... Rest> static inline Lanes horner(Lanes x, real first, Rest... rest) {
    Lanes y = all(first);
    ((y = y * x + real(rest)), ...);
    return y;
}

// For results that are normal numbers.
static inline Lanes exponential(Lanes x) {
    Lanes shifted = x * real(1.4426950408889634) + MAGIC, n = shifted - MAGIC, series;
    if constexpr (SINGLE) {
        Lanes r = (x - n * real(0.693359375)) + n * real(2.12194440e-4);
        series = horner(r, 1.9891030654370327e-4, 1.3933685862617174e-3, 8.333310889582076e-3, 4.166646460202654e-2,
                        0.16666666681659179, 0.5000000013498178);
        series = 1 + (r + r * r * series);
    } else {
        Lanes r = (x - n * real(6.93147180369123816490e-01)) - n * real(1.90821492927058770002e-10), r2 = r * r;
        Lanes even = horner(r2, 2.0914717341716378e-09, 2.755727357010214e-07, 2.4801587325605324e-05,
                            0.001388888888888373, 0.04166666666666667, 0.5);
        Lanes odd = horner(r2, 2.5105259538448494e-08, 2.7557255297969643e-06, 0.0001984126987490126,
                           0.008333333333326112, 0.1666666666666667);
        series = 1 + (r + r2 * (even + r * odd));
    }
    Whole power = (low_bits(shifted) + (SINGLE ? 127 : 1023)) << (SINGLE ? 23 : 52);
    return series * (Lanes)power;
}

static inline void sincos(Lanes x, Lanes &sine, Lanes &cosine) {
    Lanes shifted = x * real(0.63661977236758134) + MAGIC, n = shifted - MAGIC, p, q, r;
    Whole quadrant = low_bits(shifted);
    if constexpr (SINGLE) {
        r = ((x - n * real(1.5703125)) - n * real(4.837512969970703e-4)) - n * real(7.549789948768648e-8);
        p = horner(r * r, -1.9515295891e-4, 8.3321608736e-3, -1.6666654611e-1);
        q = horner(r * r, 2.443315711809948e-5, -1.388731625493765e-3, 4.166664568298827e-2);
    } else {
        r = (x - n * real(1.57079632673412561417)) - n * real(6.07710050630396597660e-11);
        p = horner(r * r, 1.58969099521155010221e-10, -2.50507602534068634195e-08, 2.75573137070700676789e-06,
                   -1.98412698298579493134e-04, 8.33333333332248946124e-03, -1.66666666666666324348e-01);
        q = horner(r * r, -1.13596475577881948265e-11, 2.08757232129817482790e-09, -2.75573143513906633035e-07,
                   2.48015872894767294178e-05, -1.38888888888741095749e-03, 4.16666666666666019037e-02);
    }
    Lanes z = r * r, s = r + r * z * p, c = 1 - (z / 2 - z * z * q);
    Whole swap = (quadrant & 1) != 0, down = (quadrant & 2) != 0, up = ((quadrant + 1) & 2) != 0;
    sine = swap ? c : s;
    cosine = swap ? s : c;
    sine = down ? -sine : sine;
    cosine = up ? -cosine : cosine;
}

struct State { Lanes angle, velocity, p1, p2; };

struct Knee {
    Parameters k;  // what all lanes share
    Lanes gravity, per_inertia;
    real per_length, per_lag, sin_hanging, cos_hanging;

    // Torque of the muscles; its derivative where `slope` is not null.
    inline Lanes torque(const State &x, Lanes s, Lanes c, Lanes *slope) const {
        Lanes across = k.r * (1 - c), total{}, total_slope{};
        for (int i = 0; i < 2; i++) {
            real sign = i == 0 ? 1 : -1;
            Lanes along = k.H + sign * k.r * s, squared = along * along + across * across;
            Lanes q = root(squared), per_q = 1 / q, arm = k.r * (k.H * c + sign * k.r * s) * per_q;
            Lanes p = i == 0 ? x.p1 : x.p2, eps = 1 - (q - k.connector) * per_length;
            Lanes straight = k.b1 + k.b2 * p, decayed = (k.c1 + k.c2 * p) * exponential(-k.decay * eps);
            Lanes law = (k.a1 + k.a2 * p) + straight * eps + decayed, force = larger(law, Lanes{});
            total -= sign * force * arm;
            if (slope) {
                Lanes stretch = law > 0 ? straight - k.decay * decayed : Lanes{};
                Lanes arm_slope = (k.r * (sign * k.r * c - k.H * s) - sign * arm * arm) * per_q;
                total_slope += stretch * per_length * arm * arm - sign * force * arm_slope;
            }
        }
        if (slope) *slope = total_slope;
        return total;
    }

    inline Lanes stiffness(const State &x) const {
        Lanes s, c, slope;
        sincos(x.angle, s, c);
        torque(x, s, c, &slope);
        return -slope;
    }

    inline State rate(const State &x, Lanes u1, Lanes u2) const {
        Lanes s, c;
        sincos(x.angle, s, c);
        Lanes net = torque(x, s, c, nullptr) + gravity * (sin_hanging * c - cos_hanging * s) - k.damping * x.velocity;
        return {x.velocity, net * per_inertia, (u1 - x.p1) * per_lag, (u2 - x.p2) * per_lag};
    }
};

static inline State moved(const State &x, const State &d, real h) {
    return {x.angle + h * d.angle, x.velocity + h * d.velocity, x.p1 + h * d.p1, x.p2 + h * d.p2};
}

static inline State rk4(const Knee &knee, const State &x, Lanes u1, Lanes u2, real h) {
    State d = knee.rate(x, u1, u2), sum = d;
    for (int stage = 1; stage < 4; stage++) {
        d = knee.rate(moved(x, d, stage < 3 ? h / 2 : h), u1, u2);
        sum = moved(sum, d, stage < 3 ? 2 : 1);
    }
    return moved(x, sum, h / 6);
}

struct Pid { Lanes integral, differentiated, derivative; };

static inline Lanes pid(const Parameters &k, int i, Pid &m, Lanes wanted, Lanes measured, real h) {
    Lanes error = wanted - measured;
    m.derivative = (k.filter[i] * m.derivative - measured - m.differentiated) * (1 / (k.filter[i] + h));
    m.differentiated = -measured;
    m.integral += k.ki[i] * h * error;
    return k.kp[i] * error + m.integral + k.kd[i] * m.derivative;
}

static inline void realised(const Parameters &k, int i, Pid &m, Lanes output, Lanes value, real h) {
    real share = h / k.tracking[i];
    m.integral += (share < 1 ? share : 1) * (value - output);
}

static void bundle(const Parameters *lanes, const Run *run, real *metrics) {
    Knee knee{lanes[0], {}, {}, 1 / lanes[0].l0, 1 / lanes[0].time_constant, 0, 0};
    knee.sin_hanging = __builtin_sin(lanes[0].hanging), knee.cos_hanging = __builtin_cos(lanes[0].hanging);
    for (int i = 0; i < WIDTH; i++) knee.gravity[i] = lanes[i].gravity, knee.per_inertia[i] = 1 / lanes[i].inertia;
    const Parameters &k = knee.k;
    State x{all(run->start[0]), all(run->start[1]), all(run->start[2]), all(run->start[3])};
    Pid position{(x.p2 - x.p1) / 2, -x.angle, {}}, firmness{(x.p1 + x.p2) / 2, -knee.stiffness(x), {}};
    Lanes angle_sum{}, stiffness_sum{};
    real h = run->period;
    for (long n = 0; n < run->periods; n++) {
        Lanes estimate = knee.stiffness(x), wanted = all(run->wanted_angle[n]), firm = all(run->wanted_stiffness[n]);
        Lanes pd = pid(k, 0, position, wanted, x.angle, h), pc = pid(k, 1, firmness, firm, estimate, h);
        Lanes u1 = clip(pc - pd, k.low, k.high), u2 = clip(pc + pd, k.low, k.high);
        realised(k, 0, position, pd, (u2 - u1) / 2, h);
        realised(k, 1, firmness, pc, (u1 + u2) / 2, h);
        angle_sum += (wanted - x.angle) * (wanted - x.angle);
        stiffness_sum += (firm - estimate) * (firm - estimate);
        for (long i = 0; i < run->substeps; i++) x = rk4(knee, x, u1, u2, h / run->substeps);
    }
    angle_sum = root(angle_sum / real(run->periods)), stiffness_sum = root(stiffness_sum / real(run->periods));
    for (int i = 0; i < WIDTH; i++) metrics[2 * i] = angle_sum[i], metrics[2 * i + 1] = stiffness_sum[i];
}

// Lanes may differ in inertia and gravity; their count has to be a multiple of WIDTH. Two metrics each, as in episode.c.
extern "C" void episodes(const Parameters *lanes, long count, const Run *run, real *metrics) {
    for (long i = 0; i < count; i += WIDTH) bundle(lanes + i, run, metrics + 2 * i);
}
