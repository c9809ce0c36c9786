/* MuJoCo plugin "$plugin": force of the muscles of ${name}.c as an actuator force, never above 0 (muscles pull).
 * Attribute "muscle": 1 to $count.
 * Activations: state of the creep [N, Pa], valve state, pressure [Pa]. Plugin state: status, command of the last step,
 * anchors of the friction [m].
 */
#include "$name.h"

#include <stdlib.h>
#include <string.h>

#include <mujoco/mujoco.h>

enum { UNSET, SETTLED, STEPPED }; /* status: before the first call; afterwards; after an integration step */

typedef struct {
    $name model;
    int muscle, actuator;
} Muscle;

static const char *const ATTRIBUTES[] = {"muscle"};

static int muscle_of(const mjModel *m, int instance)
{
    const char *text = mj_getPluginConfig(m, instance, "muscle");
    char *end;
    long number = text ? strtol(text, &end, 10) : 0;
    return number > 0 && number <= $count && !*end ? (int)number : 0;
}

static double command(const mjModel *m, const mjData *d, int i)
{
    const double *range = m->actuator_ctrlrange + 2 * i;
    return m->actuator_ctrllimited[i] ? mju_clip(d->ctrl[i], range[0], range[1]) : d->ctrl[i];
}
$muscles
typedef void (*Function)(const $name *model, const mjModel *m, mjData *d, int i, mjtNum *state);

static const struct {
    int anchors;
    Function act_dot, force;
} MUSCLES[] = {
    {0, 0, 0},
$rows};

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
        mju_warning("$plugin: the attribute muscle is 1 to $count, of an actuator");
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

mjPLUGIN_LIB_INIT($name)
{
    mjpPlugin plugin;
    mjp_defaultPlugin(&plugin);
    plugin.name = "$plugin";
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
