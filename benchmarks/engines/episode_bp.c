/* The reference episode with BP loops (mckibben.control.BackpropPID with Jacobian.SIGN) in plain C. */
#include "knee.h"

enum { HIDDEN = 6, INPUTS = 4, GAINS = 3 };

typedef struct {
    real signal, error, output; /* scales */
    real learning_rate, momentum, gain_ratio;
    real hidden[HIDDEN][INPUTS]; /* weights at the start */
} Network;

typedef struct {
    Pid pid; /* `integral` is the whole output: the loop is in velocity form */
    real hidden[HIDDEN][INPUTS], hidden_change[HIDDEN][INPUTS];
    real output[GAINS][HIDDEN + 1], output_change[GAINS][HIDDEN + 1];
    real error;
} Memory;

static Memory begin(const Network *w, real measured, real output) {
    Memory m = {.pid = {output, -measured, 0}};
    for (int j = 0; j < HIDDEN; j++)
        for (int i = 0; i < INPUTS; i++) m.hidden[j][i] = w->hidden[j][i];
    return m;
}

static real step(const Parameters *k, int loop, const Network *w, Memory *m, real wanted, real measured, real h) {
    real error = wanted - measured, filtered = derivative(k, loop, &m->pid, measured, h);
    real inputs[INPUTS] = {wanted / w->signal, measured / w->signal, error / w->error, 1};
    real parts[GAINS] = {k->kp[loop] * (error - m->error), k->ki[loop] * h * error,
                         k->kd[loop] * (filtered - m->pid.derivative)};
    real sign = k->ki[loop] > 0 ? 1 : k->ki[loop] < 0 ? -1 : 0;
    real push = w->learning_rate * error / w->error * sign / w->output;
    real activation[HIDDEN], back[HIDDEN] = {0}, change = 0;

    for (int j = 0; j < HIDDEN; j++) {
        real inner = 0;
        for (int i = 0; i < INPUTS; i++) inner += m->hidden[j][i] * inputs[i];
        activation[j] = tanh(inner);
    }
    for (int g = 0; g < GAINS; g++) {
        real outer = m->output[g][HIDDEN];
        for (int j = 0; j < HIDDEN; j++) outer += m->output[g][j] * activation[j];
        real t = tanh(outer), part = pow(w->gain_ratio, t) * parts[g];
        real slope = part * log(w->gain_ratio) * (1 - t * t); /* d change / d outer */
        change += part;
        for (int j = 0; j < HIDDEN; j++) {
            back[j] += slope * m->output[g][j];
            m->output_change[g][j] = push * slope * activation[j] + w->momentum * m->output_change[g][j];
            m->output[g][j] += m->output_change[g][j];
        }
        m->output_change[g][HIDDEN] = push * slope + w->momentum * m->output_change[g][HIDDEN];
        m->output[g][HIDDEN] += m->output_change[g][HIDDEN];
    }
    for (int j = 0; j < HIDDEN; j++) {
        real slope = push * back[j] * (1 - activation[j] * activation[j]);
        for (int i = 0; i < INPUTS; i++) {
            m->hidden_change[j][i] = slope * inputs[i] + w->momentum * m->hidden_change[j][i];
            m->hidden[j][i] += m->hidden_change[j][i];
        }
    }
    m->error = error;
    m->pid = (Pid){m->pid.integral + change, -measured, filtered};
    return m->pid.integral;
}

/* Run one episode; `networks` are those of the position and the stiffness loop, `out` as in `keep`. */
void episode_bp(const Parameters *k, const Network *networks, const Run *run, real *out) {
    State x = {run->start[0], run->start[1], run->start[2], run->start[3]};
    Memory position = begin(networks, x.angle, (x.p2 - x.p1) / 2);
    Memory firmness = begin(networks + 1, stiffness(k, &x), (x.p1 + x.p2) / 2);
    real period = run->period, h = period / run->substeps;
    for (long n = 0; n < run->periods; n++) {
        real estimate = stiffness(k, &x);
        real pd = step(k, 0, networks, &position, run->wanted_angle[n], x.angle, period);
        real pc = step(k, 1, networks + 1, &firmness, run->wanted_stiffness[n], estimate, period);
        real u1 = clip(pc - pd, k->low, k->high), u2 = clip(pc + pd, k->low, k->high);
        realised(k, 0, &position.pid, pd, (u2 - u1) / 2, period);
        realised(k, 1, &firmness.pid, pc, (u1 + u2) / 2, period);
        keep(run, n, &x, u1, u2, estimate, out, NULL);
        for (long i = 0; i < run->substeps; i++) x = rk4(k, &x, u1, u2, h);
    }
}
