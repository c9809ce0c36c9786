/* The reference episode in plain C: two PID loops with zero-order hold. */
#include "knee.h"

static real pid(const Parameters *k, int i, Pid *m, real wanted, real measured, real h) {
    real error = wanted - measured;
    m->derivative = derivative(k, i, m, measured, h);
    m->differentiated = -measured;
    m->integral += k->ki[i] * h * error;
    return k->kp[i] * error + m->integral + k->kd[i] * m->derivative;
}

/* Run one episode; see `keep` for `out` and `metrics`, which are the RMS errors of angle and stiffness. */
void episode(const Parameters *k, const Run *run, real *out, real *metrics) {
    State x = {run->start[0], run->start[1], run->start[2], run->start[3]};
    Pid position = {(x.p2 - x.p1) / 2, -x.angle, 0}, firmness = {(x.p1 + x.p2) / 2, -stiffness(k, &x), 0};
    real period = run->period, h = period / run->substeps, sums[2] = {0, 0};
    for (long n = 0; n < run->periods; n++) {
        real estimate = stiffness(k, &x);
        real pd = pid(k, 0, &position, run->wanted_angle[n], x.angle, period);
        real pc = pid(k, 1, &firmness, run->wanted_stiffness[n], estimate, period);
        real u1 = clip(pc - pd, k->low, k->high), u2 = clip(pc + pd, k->low, k->high);
        realised(k, 0, &position, pd, (u2 - u1) / 2, period);
        realised(k, 1, &firmness, pc, (u1 + u2) / 2, period);
        keep(run, n, &x, u1, u2, estimate, out, metrics ? sums : NULL);
        for (long i = 0; i < run->substeps; i++) x = rk4(k, &x, u1, u2, h);
    }
    if (metrics) metrics[0] = sqrt(sums[0] / run->periods), metrics[1] = sqrt(sums[1] / run->periods);
}

/* Run one episode a lane, one after the other; two metrics each, nothing else kept. */
void episodes(const Parameters *lanes, long count, const Run *run, real *metrics) {
    for (long i = 0; i < count; i++) episode(lanes + i, run, NULL, metrics + 2 * i);
}
