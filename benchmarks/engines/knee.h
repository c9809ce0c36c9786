/* The knee of the paper (Eqs. 3-8) with first-order valves and two loops, in plain scalar C.
 *
 * libm's exp, sin, cos; no vectors, no threads. RK4 with any number of substeps, stiffness from the closed-form
 * derivative of the torque. -DREAL=float gives the same in single precision.
 */
#ifndef KNEE_H
#define KNEE_H
#include <stddef.h>
#include <tgmath.h>

#ifndef REAL
#define REAL double
#endif
typedef REAL real;

typedef struct {
    real a1, a2, b1, b2, c1, c2, decay;               /* Eq. 2 in SI */
    real l0, H, r, connector;                         /* Eq. 4 */
    real inertia, damping, gravity, hanging;          /* Eq. 6 */
    real time_constant, low, high;                    /* valves and their limits */
    real kp[2], ki[2], kd[2], filter[2], tracking[2]; /* position loop, stiffness loop */
} Parameters;

typedef struct { real angle, velocity, p1, p2; } State;

static inline real clip(real x, real low, real high) { return x < low ? low : x > high ? high : x; }

/* Path lengths and moment arms, Eqs. 4 and 5; and the derivatives of the arms where asked for. */
static inline void geometry(const Parameters *k, real angle, real path[2], real arm[2], real arm_slope[2]) {
    real s = sin(angle), c = cos(angle), across = k->r * (1 - c);
    for (int i = 0; i < 2; i++) {
        int sign = i == 0 ? 1 : -1;
        real along = k->H + sign * k->r * s;
        real q = sqrt(along * along + across * across);
        path[i] = q - k->connector;
        arm[i] = k->r * (k->H * c + sign * k->r * s) / q;
        if (arm_slope) {
            real q_slope = sign * arm[i];
            arm_slope[i] = k->r * (-k->H * s + sign * k->r * c) / q - arm[i] * q_slope / q;
        }
    }
}

static inline void muscle(const Parameters *k, real path, real p, real *force, real *slope) {
    real eps = 1 - path / k->l0, e = exp(-k->decay * eps);
    real f = (k->a1 + k->a2 * p) + (k->b1 + k->b2 * p) * eps + (k->c1 + k->c2 * p) * e;
    *force = f > 0 ? f : 0;
    if (slope) *slope = f > 0 ? (k->b1 + k->b2 * p) - k->decay * (k->c1 + k->c2 * p) * e : 0;
}

static inline real torque(const Parameters *k, const State *x) {
    real path[2], arm[2], f1, f2;
    geometry(k, x->angle, path, arm, NULL);
    muscle(k, path[0], x->p1, &f1, NULL);
    muscle(k, path[1], x->p2, &f2, NULL);
    return f2 * arm[1] - f1 * arm[0];
}

static inline real stiffness(const Parameters *k, const State *x) {
    real path[2], arm[2], arm_slope[2], f1, f2, s1, s2;
    geometry(k, x->angle, path, arm, arm_slope);
    muscle(k, path[0], x->p1, &f1, &s1);
    muscle(k, path[1], x->p2, &f2, &s2);
    /* d eps1/d theta = -arm1/l0, d eps2/d theta = +arm2/l0 */
    real slope1 = -s1 * arm[0] / k->l0 * arm[0] + f1 * arm_slope[0];
    real slope2 = s2 * arm[1] / k->l0 * arm[1] + f2 * arm_slope[1];
    return slope1 - slope2;
}

static inline State rate(const Parameters *k, const State *x, real u1, real u2) {
    State d;
    real gravity = k->gravity * sin(k->hanging - x->angle);
    d.angle = x->velocity;
    d.velocity = (torque(k, x) + gravity - k->damping * x->velocity) / k->inertia;
    d.p1 = (u1 - x->p1) / k->time_constant;
    d.p2 = (u2 - x->p2) / k->time_constant;
    return d;
}

static inline State moved(const State *x, const State *d, real h) {
    State y = {x->angle + h * d->angle, x->velocity + h * d->velocity, x->p1 + h * d->p1, x->p2 + h * d->p2};
    return y;
}

static inline State rk4(const Parameters *k, const State *x, real u1, real u2, real h) {
    State k1 = rate(k, x, u1, u2), at = moved(x, &k1, h / 2);
    State k2 = rate(k, &at, u1, u2);
    at = moved(x, &k2, h / 2);
    State k3 = rate(k, &at, u1, u2);
    at = moved(x, &k3, h);
    State k4 = rate(k, &at, u1, u2), y;
    y.angle = x->angle + h / 6 * (k1.angle + 2 * (k2.angle + k3.angle) + k4.angle);
    y.velocity = x->velocity + h / 6 * (k1.velocity + 2 * (k2.velocity + k3.velocity) + k4.velocity);
    y.p1 = x->p1 + h / 6 * (k1.p1 + 2 * (k2.p1 + k3.p1) + k4.p1);
    y.p2 = x->p2 + h / 6 * (k1.p2 + 2 * (k2.p2 + k3.p2) + k4.p2);
    return y;
}

typedef struct { real integral, differentiated, derivative; } Pid;

/* The filtered derivative of the measurement one control period later. */
static inline real derivative(const Parameters *k, int i, const Pid *m, real measured, real h) {
    return (k->filter[i] * m->derivative + (-measured - m->differentiated)) / (k->filter[i] + h);
}

/* Anti-windup: the integral follows what could be realised of the output. */
static inline void realised(const Parameters *k, int i, Pid *m, real output, real value, real h) {
    real share = h / k->tracking[i];
    m->integral += (share < 1 ? share : 1) * (value - output);
}

/* The setpoints and the clock of an episode. */
typedef struct {
    const real *wanted_angle, *wanted_stiffness;
    real start[4];
    long periods, substeps;
    real period;
} Run;

/* What is kept of an episode: 7 columns a period (angle, velocity, p1, p2, u1, u2, estimated stiffness), or the sums of
 * the squared errors of angle and stiffness; each where its pointer is not NULL. */
static inline void keep(const Run *run, long n, const State *x, real u1, real u2, real estimate, real *out,
                        real *sums) {
    if (out) {
        out += 7 * n;
        out[0] = x->angle, out[1] = x->velocity, out[2] = x->p1, out[3] = x->p2, out[4] = u1, out[5] = u2;
        out[6] = estimate;
    }
    if (sums) {
        real angle = run->wanted_angle[n] - x->angle, firmness = run->wanted_stiffness[n] - estimate;
        sums[0] += angle * angle;
        sums[1] += firmness * firmness;
    }
}
#endif
