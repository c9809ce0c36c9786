/* The reference episode in plain C: what JAX is measured against in episode.py.
 *
 * Knee of the paper (Eqs. 3-8), first-order valves, two PID loops at 1 kHz with zero-order hold, RK4 with 4 substeps,
 * stiffness from the closed-form derivative of the torque. libm's exp, sin, cos; no vectors, no threads.
 */
#include <math.h>
#include <stddef.h>

typedef struct {
    double a1, a2, b1, b2, c1, c2, decay;             /* Eq. 2 in SI */
    double l0, H, r, connector;                       /* Eq. 4 */
    double inertia, damping, gravity, hanging;        /* Eq. 6 */
    double time_constant, low, high;                  /* valves and their limits */
    double kp[2], ki[2], kd[2], filter[2], tracking[2]; /* position loop, stiffness loop */
} Parameters;

typedef struct { double angle, velocity, p1, p2; } State;

static double clip(double x, double low, double high) { return x < low ? low : x > high ? high : x; }

/* Path lengths and moment arms, Eqs. 4 and 5; and the derivatives of the arms where asked for. */
static void geometry(const Parameters *k, double angle, double path[2], double arm[2], double arm_slope[2]) {
    double s = sin(angle), c = cos(angle), across = k->r * (1 - c);
    for (int i = 0; i < 2; i++) {
        double sign = i == 0 ? 1.0 : -1.0;
        double along = k->H + sign * k->r * s;
        double q = sqrt(along * along + across * across);
        path[i] = q - k->connector;
        arm[i] = k->r * (k->H * c + sign * k->r * s) / q;
        if (arm_slope) {
            double q_slope = sign * arm[i];
            arm_slope[i] = k->r * (-k->H * s + sign * k->r * c) / q - arm[i] * q_slope / q;
        }
    }
}

static void muscle(const Parameters *k, double path, double p, double *force, double *slope) {
    double eps = 1 - path / k->l0, e = exp(-k->decay * eps);
    double f = (k->a1 + k->a2 * p) + (k->b1 + k->b2 * p) * eps + (k->c1 + k->c2 * p) * e;
    *force = f > 0 ? f : 0;
    if (slope) *slope = f > 0 ? (k->b1 + k->b2 * p) - k->decay * (k->c1 + k->c2 * p) * e : 0;
}

static double torque(const Parameters *k, const State *x) {
    double path[2], arm[2], f1, f2;
    geometry(k, x->angle, path, arm, NULL);
    muscle(k, path[0], x->p1, &f1, NULL);
    muscle(k, path[1], x->p2, &f2, NULL);
    return f2 * arm[1] - f1 * arm[0];
}

static double stiffness(const Parameters *k, const State *x) {
    double path[2], arm[2], arm_slope[2], f1, f2, s1, s2;
    geometry(k, x->angle, path, arm, arm_slope);
    muscle(k, path[0], x->p1, &f1, &s1);
    muscle(k, path[1], x->p2, &f2, &s2);
    /* d eps1/d theta = -arm1/l0, d eps2/d theta = +arm2/l0 */
    double slope1 = -s1 * arm[0] / k->l0 * arm[0] + f1 * arm_slope[0];
    double slope2 = s2 * arm[1] / k->l0 * arm[1] + f2 * arm_slope[1];
    return slope1 - slope2;
}

static State rate(const Parameters *k, const State *x, double u1, double u2) {
    State d;
    double gravity = k->gravity * sin(k->hanging - x->angle);
    d.angle = x->velocity;
    d.velocity = (torque(k, x) + gravity - k->damping * x->velocity) / k->inertia;
    d.p1 = (u1 - x->p1) / k->time_constant;
    d.p2 = (u2 - x->p2) / k->time_constant;
    return d;
}

static State moved(const State *x, const State *d, double h) {
    State y = {x->angle + h * d->angle, x->velocity + h * d->velocity, x->p1 + h * d->p1, x->p2 + h * d->p2};
    return y;
}

static State rk4(const Parameters *k, const State *x, double u1, double u2, double h) {
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

typedef struct { double integral, differentiated, derivative; } Pid;

static double pid(const Parameters *k, int i, Pid *m, double wanted, double measured, double h) {
    double error = wanted - measured, change = -measured - m->differentiated;
    m->derivative = (k->filter[i] * m->derivative + change) / (k->filter[i] + h);
    m->differentiated = -measured;
    m->integral += k->ki[i] * h * error;
    return k->kp[i] * error + m->integral + k->kd[i] * m->derivative;
}

static void realised(const Parameters *k, int i, Pid *m, double output, double value, double h) {
    double share = h / k->tracking[i];
    m->integral += (share < 1 ? share : 1) * (value - output);
}

/* Run an episode; out has 7 columns a period: angle, velocity, p1, p2, u1, u2, estimated stiffness. */
void episode(const Parameters *k, const double *wanted_angle, const double *wanted_stiffness, const double *start,
             long periods, double period, long substeps, double *out) {
    State x = {start[0], start[1], start[2], start[3]};
    Pid position = {(x.p2 - x.p1) / 2, -x.angle, 0}, firmness = {(x.p1 + x.p2) / 2, -stiffness(k, &x), 0};
    double h = period / substeps;
    for (long n = 0; n < periods; n++, out += 7) {
        double estimate = stiffness(k, &x);
        double pd = pid(k, 0, &position, wanted_angle[n], x.angle, period);
        double pc = pid(k, 1, &firmness, wanted_stiffness[n], estimate, period);
        double u1 = clip(pc - pd, k->low, k->high), u2 = clip(pc + pd, k->low, k->high);
        realised(k, 0, &position, pd, (u2 - u1) / 2, period);
        realised(k, 1, &firmness, pc, (u1 + u2) / 2, period);
        out[0] = x.angle, out[1] = x.velocity, out[2] = x.p1, out[3] = x.p2, out[4] = u1, out[5] = u2;
        out[6] = estimate;
        for (long i = 0; i < substeps; i++) x = rk4(k, &x, u1, u2, h);
    }
}
