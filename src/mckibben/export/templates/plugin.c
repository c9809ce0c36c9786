/* MuJoCo plugin "mckibben.${name}": force of the muscles of ${name}.c as an actuator force, never above 0 (muscles pull).
 * Attribute "muscle": 1 to ${muscles | length}.
 * Activations: state of the creep [N, Pa], valve state, pressure [Pa]. Plugin state: status, command of the last step,
 * anchors of the friction [m].
 */
#include "${name}.h"

#include <stdlib.h>
#include <string.h>

#include <mujoco/mujoco.h>

enum { UNSET, SETTLED, STEPPED }; /* status: before the first call; afterwards; after an integration step */

typedef struct {
    ${name} model;
    int muscle, actuator;
} Muscle;

static const char *const ATTRIBUTES[] = {"muscle"};

static int muscle_of(const mjModel *m, int instance)
{
    const char *text = mj_getPluginConfig(m, instance, "muscle");
    char *end;
    long number = text ? strtol(text, &end, 10) : 0;
    return number > 0 && number <= ${muscles | length} && !*end ? (int)number : 0;
}

static double command(const mjModel *m, const mjData *d, int i)
{
    const double *range = m->actuator_ctrlrange + 2 * i;
    return m->actuator_ctrllimited[i] ? mju_clip(d->ctrl[i], range[0], range[1]) : d->ctrl[i];
}
<% for muscle in muscles %>

static ${name}_input${loop.index} input${loop.index}(const ${name} *model, const mjModel *m, mjData *d, int i, mjtNum *state)
{
    ${name}_input${loop.index} given;
    mjtNum *act = d->act + (m->actuator_actadr[i] < 0 ? 0 : m->actuator_actadr[i]);
    given.length = d->actuator_length[i];
    given.velocity = d->actuator_velocity[i];
    given.command = command(m, d, i);
    (void)act;
    (void)state;
    (void)model;
#if ${muscle.activations}
    memcpy(given.act, act, sizeof given.act);
#endif
#if ${muscle.anchors}
    if (state[0] == UNSET) {
        ${name}_first${loop.index} first;
        ${name}_unset${loop.index}(model, &given, &first);
        memcpy(state + 2, first.anchors, sizeof first.anchors);
    }
    memcpy(given.anchors, state + 2, sizeof given.anchors);
#endif
#if ${muscle.slips | int}
    if (state[0] == STEPPED) {
        ${name}_after${loop.index} after;
        given.command = state[1];
        ${name}_settled${loop.index}(model, &given, &after);
#if ${muscle.activations}
        memcpy(act, after.act, sizeof after.act);
        memcpy(given.act, after.act, sizeof after.act);
#endif
#if ${muscle.anchors}
        memcpy(state + 2, after.anchors, sizeof after.anchors);
        memcpy(given.anchors, after.anchors, sizeof after.anchors);
#endif
        given.command = command(m, d, i);
    }
    state[0] = SETTLED;
#endif
    return given;
}

static void act_dot${loop.index}(const ${name} *model, const mjModel *m, mjData *d, int i, mjtNum *state)
{
    ${name}_input${loop.index} given = input${loop.index}(model, m, d, i, state);
    (void)given;
#if ${muscle.activations - muscle.filtered}
    ${name}_rate${loop.index} found;
    ${name}_rates${loop.index}(model, &given, &found);
    memcpy(d->act_dot + m->actuator_actadr[i], found.act, ${muscle.activations - muscle.filtered} * sizeof(mjtNum));
#endif
}

static void force${loop.index}(const ${name} *model, const mjModel *m, mjData *d, int i, mjtNum *state)
{
    ${name}_input${loop.index} given = input${loop.index}(model, m, d, i, state);
    d->actuator_force[i] = ${name}_force${loop.index}(model, &given);
}
<% endfor %>

typedef void (*Function)(const ${name} *model, const mjModel *m, mjData *d, int i, mjtNum *state);

static const struct {
    int anchors;
    Function act_dot, force;
} MUSCLES[] = {
    {0, 0, 0},
<% for muscle in muscles %>
    {${muscle.anchors}, act_dot${loop.index}, force${loop.index}},
<% endfor %>
};

static int nstate(const mjModel *m, int instance)
{
    return 2 + MUSCLES[muscle_of(m, instance)].anchors;
}

static int init(const mjModel *m, mjData *d, int instance)
{
    Muscle *one = malloc(sizeof(Muscle));
    int i;
    if (!one)
        return -1;
    one->muscle = muscle_of(m, instance);
    one->actuator = -1;
    for (i = 0; i < m->nu; ++i)
        if (m->actuator_plugin[i] == instance)
            one->actuator = i;
    if (!one->muscle || one->actuator < 0) {
        free(one);
        mju_warning("mckibben.${name}: the attribute muscle is 1 to ${muscles | length}, of an actuator");
        return -1;
    }
    ${name}_defaults(&one->model);
    d->plugin_data[instance] = (uintptr_t)one;
    return 0;
}

static void destroy(mjData *d, int instance)
{
    free((void *)d->plugin_data[instance]);
    d->plugin_data[instance] = 0;
}

static void reset(const mjModel *m, mjtNum *state, void *data, int instance)
{
    (void)data;
    memset(state, 0, sizeof(mjtNum) * (size_t)nstate(m, instance));
}

static void act_dot(const mjModel *m, mjData *d, int instance)
{
    const Muscle *one = (const Muscle *)d->plugin_data[instance];
    mjtNum *state = d->plugin_state + m->plugin_stateadr[instance];
    MUSCLES[one->muscle].act_dot(&one->model, m, d, one->actuator, state);
}

static void compute(const mjModel *m, mjData *d, int instance, int capability)
{
    const Muscle *one = (const Muscle *)d->plugin_data[instance];
    mjtNum *state = d->plugin_state + m->plugin_stateadr[instance];
    (void)capability;
    MUSCLES[one->muscle].force(&one->model, m, d, one->actuator, state);
}

static void advance(const mjModel *m, mjData *d, int instance)
{
    const Muscle *one = (const Muscle *)d->plugin_data[instance];
    mjtNum *state = d->plugin_state + m->plugin_stateadr[instance];
    state[1] = command(m, d, one->actuator);
    if (state[0] == SETTLED)
        state[0] = STEPPED;
}

mjPLUGIN_LIB_INIT(${name})
{
    mjpPlugin plugin;
    mjp_defaultPlugin(&plugin);
    plugin.name = "mckibben.${name}";
    plugin.capabilityflags |= mjPLUGIN_ACTUATOR;
    plugin.nattribute = 1;
    plugin.attributes = ATTRIBUTES;
    plugin.nstate = nstate;
    plugin.init = init;
    plugin.destroy = destroy;
    plugin.reset = reset;
    plugin.actuator_act_dot = act_dot;
    plugin.compute = compute;
    plugin.advance = advance;
    mjp_registerPlugin(&plugin);
}
