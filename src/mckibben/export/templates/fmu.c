/* FMI 2.0 of "${title}": an instance with the variables of ${name}.c, start values, steps and saved states; below, the
 * functions of the standard. */
#include "fmi2Functions.h"

#include "${name}.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { VARIABLES = ${variables | length}, STATES = ${rates | length}, MODEL_EXCHANGE = ${model_exchange}, SAMPLED = ${sampled} };
static const double LONGEST = ${longest}; /* s, per call of advance; the period of a sampled function */

typedef enum { BEFORE, INITIALIZATION, RUNNING } fmu_mode;

typedef struct {
    ${name} model;
<% for structure in structures %>
    ${name}_${structure} ${structure};
<% endfor %>
    double time;
    fmu_mode mode;
    bool changed; /* parameters, since the last prepare */
    bool fresh;   /* results match parameters, state and inputs */
} fmu_content;

typedef struct {
    fmu_content content;
    char message[256]; /* of the last failure */
} fmu_instance;

/* p parameter, s state that has a start value, c other continuous state, i input, o result, t time */
typedef struct {
    size_t place;
    char kind;
    double start, nominal;
} fmu_variable;

static const fmu_variable VARIABLE[VARIABLES] = {
<% for variable in variables %>
    {offsetof(fmu_content, ${variable.place}), '${variable.kind}', ${literal(variable.start or 0.0)}, ${nominal.get(variable.unit, 1.0)}},
<% endfor %>
};
static const fmi2ValueReference STATE[] = {${rates.values() | join(', ') or 0}}, RATE[] = {${rates | join(', ') or 0}};

static double *fmu_at(fmu_content *self, fmi2ValueReference reference)
{
    return (double *)(void *)((char *)self + VARIABLE[reference].place);
}

static void fmu_initialize(fmu_content *self)
{
<% for member in starts %>
    self->start.${member} = self->model.state.${member};
<% endfor %>
    ${calls["init"]};
}

static void fmu_results(fmu_content *self)
{
    ${calls["evaluate"]};
<% if "differentiate" in calls %>
    ${calls["differentiate"]};
<% endif %>
}

static void fmu_advance(fmu_content *self, double duration)
{
    (void)duration;
    ${calls["advance"]};
}

static void fmu_project(fmu_content *self)
{
    (void)self;
<% if "project" in calls %>
    ${calls["project"]};
<% endif %>
}

static void fmu_refresh(fmu_content *self)
{
    if (self->changed)
        ${name}_prepare(&self->model);
    if (self->changed || !self->fresh) {
        if (self->mode != RUNNING)
            fmu_initialize(self);
        fmu_results(self);
    }
    self->changed = false;
    self->fresh = true;
}

/* Functions that can fail leave a message. */
static bool fmu_fail(fmu_instance *self, const char *text, ...)
{
    va_list arguments;
    va_start(arguments, text);
    vsnprintf(self->message, sizeof self->message, text, arguments);
    va_end(arguments);
    return false;
}

static bool fmu_none(fmu_instance *self, size_t count, const char *what)
{
    return !count || fmu_fail(self, "there are no %s", what);
}

static bool fmu_reset(fmu_instance *self)
{
    fmu_content *content = &self->content;
    fmi2ValueReference number;
    memset(content, 0, sizeof *content);
    ${name}_defaults(&content->model);
    for (number = 0; number < VARIABLES; ++number)
        if (VARIABLE[number].kind == 's' || VARIABLE[number].kind == 'i')
            *fmu_at(content, number) = VARIABLE[number].start;
    return true;
}

static bool fmu_begin(fmu_instance *self, const char *token, bool model_exchange)
{
    fmu_reset(self);
    return (token && strcmp(token, "$guid") == 0 && (MODEL_EXCHANGE || !model_exchange)) ||
           fmu_fail(self, "the identifier is that of another FMU, or this one is for co-simulation only");
}

static bool fmu_enter_initialization(fmu_instance *self)
{
    self->content.mode = INITIALIZATION;
    return true;
}

static bool fmu_exit_initialization(fmu_instance *self)
{
    self->content.fresh = false;
    fmu_refresh(&self->content);
    self->content.mode = RUNNING;
    return true;
}

static bool fmu_set_time(fmu_instance *self, double time)
{
    self->content.time = time;
    return true;
}

static bool fmu_get(fmu_instance *self, const fmi2ValueReference references[], size_t count, double values[])
{
    size_t number;
    for (number = 0; number < count; ++number) {
        if (references[number] >= VARIABLES)
            return fmu_fail(self, "there is no variable %u", (unsigned)references[number]);
        if (strchr("oc", VARIABLE[references[number]].kind))
            fmu_refresh(&self->content);
        values[number] = *fmu_at(&self->content, references[number]);
    }
    return true;
}

static bool fmu_set(fmu_instance *self, const fmi2ValueReference references[], size_t count, const double values[])
{
    size_t number;
    for (number = 0; number < count; ++number) {
        const fmi2ValueReference reference = references[number];
        const char kind = reference < VARIABLES ? VARIABLE[reference].kind : 0;
        if (kind != 'p' && kind != 'i' && !(kind == 's' && self->content.mode != RUNNING))
            return fmu_fail(self, "variable %u cannot be set now", (unsigned)reference);
        *fmu_at(&self->content, reference) = values[number];
        self->content.changed = self->content.changed || kind == 'p';
        self->content.fresh = false;
    }
    return true;
}

static bool fmu_check_states(fmu_instance *self, size_t count)
{
    return count == STATES || fmu_fail(self, "there are %d states", STATES);
}

static bool fmu_get_states(fmu_instance *self, double values[], size_t count)
{
    return fmu_check_states(self, count) && fmu_get(self, STATE, count, values);
}

static bool fmu_get_rates(fmu_instance *self, double values[], size_t count)
{
    return fmu_check_states(self, count) && fmu_get(self, RATE, count, values);
}

static bool fmu_get_nominals(fmu_instance *self, double values[], size_t count)
{
    size_t number;
    if (!fmu_check_states(self, count))
        return false;
    for (number = 0; number < count; ++number)
        values[number] = VARIABLE[STATE[number]].nominal;
    return true;
}

static bool fmu_set_states(fmu_instance *self, const double values[], size_t count)
{
    size_t number;
    if (!fmu_check_states(self, count))
        return false;
    for (number = 0; number < count; ++number)
        *fmu_at(&self->content, STATE[number]) = values[number];
    self->content.fresh = false;
    return true;
}

/* Friction follows the completed motion; the forces do not change, so this is not an event. */
static bool fmu_complete_step(fmu_instance *self)
{
    fmu_refresh(&self->content);
    fmu_project(&self->content);
    self->content.fresh = false;
    return true;
}

static bool fmu_step(fmu_instance *self, double time, double step)
{
    fmu_content *content = &self->content;
    const double count = SAMPLED ? floor(step / LONGEST + 0.5) : fmax(ceil(step / LONGEST - 1e-9), 1.0);
    double number;
    fmi2ValueReference variable;
    if (SAMPLED && (count < 1 || fabs(step - count * LONGEST) > 1e-6 * LONGEST))
        return fmu_fail(self, "a step of %g s is not a whole number of periods of %g s", step, LONGEST);
    if (!(step >= 0))
        return fmu_fail(self, "a step of %g s", step);
    fmu_refresh(content); /* sampled function: results of the initial inputs, held until new inputs are set */
    for (number = 0; number < count && step > 0; ++number)
        fmu_advance(content, step / count);
    content->time = time + step;
    content->fresh = SAMPLED;
    for (variable = 0; variable < VARIABLES; ++variable)
        if (strchr("sc", VARIABLE[variable].kind) && !isfinite(*fmu_at(content, variable)))
            return fmu_fail(self, "variable %u is not finite after %g s", (unsigned)variable, time + step);
    return true;
}

/* A saved state is a copy of the content; its serialised form is the bytes of the copy. */
static bool fmu_copy(fmu_instance *self, const void *bytes, size_t size, void **state)
{
    if (size != sizeof(fmu_content))
        return fmu_fail(self, "a state has %u bytes", (unsigned)sizeof(fmu_content));
    if (!*state && !(*state = malloc(size)))
        return fmu_fail(self, "out of memory");
    memcpy(*state, bytes, size);
    return true;
}

static bool fmu_save(fmu_instance *self, void **state)
{
    return fmu_copy(self, &self->content, sizeof self->content, state);
}

static bool fmu_restore(fmu_instance *self, const void *state)
{
    memcpy(&self->content, state, sizeof self->content);
    return true;
}

static bool fmu_write(fmu_instance *self, const void *state, void *bytes, size_t size)
{
    if (size < sizeof(fmu_content))
        return fmu_fail(self, "a state has %u bytes", (unsigned)sizeof(fmu_content));
    memcpy(bytes, state, sizeof(fmu_content));
    return true;
}

typedef struct {
    fmu_instance instance; /* first, so that a component is one */
    fmi2CallbackFunctions callbacks;
    char *name;
} fmu_component;

static fmi2Status fmu_status(fmi2Component component, bool done)
{
    const fmu_component *self = component;
    const fmi2CallbackFunctions *call = &self->callbacks;
    if (!done && call->logger)
        call->logger(call->componentEnvironment, self->name, fmi2Error, "logStatusError", "%s", self->instance.message);
    return done ? fmi2OK : fmi2Error;
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    fmu_component *self = calloc(1, sizeof *self);
    const size_t length = name ? strlen(name) + 1 : 0;
    (void)resources, (void)visible, (void)logging;
    if (!self || !callbacks || !length || !(self->name = malloc(length))) {
        free(self);
        return NULL;
    }
    memcpy(self->name, name, length);
    self->callbacks = *callbacks;
    if (fmu_status(self, fmu_begin(&self->instance, guid, type == fmi2ModelExchange)) == fmi2OK)
        return self;
    fmi2FreeInstance(self);
    return NULL;
}

void fmi2FreeInstance(fmi2Component component)
{
    if (component) {
        free(((fmu_component *)component)->name);
        free(component);
    }
}

fmi2Status fmi2SetDebugLogging(fmi2Component component, fmi2Boolean on, size_t count, const fmi2String categories[])
{
    (void)component, (void)on, (void)count, (void)categories;
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component component, fmi2Boolean tolerance_given, fmi2Real tolerance, fmi2Real begin,
                               fmi2Boolean end_given, fmi2Real end)
{
    (void)tolerance_given, (void)tolerance, (void)end_given, (void)end;
    return fmu_status(component, fmu_set_time(component, begin));
}

fmi2Status fmi2EnterInitializationMode(fmi2Component component)
{
    return fmu_status(component, fmu_enter_initialization(component));
}

fmi2Status fmi2ExitInitializationMode(fmi2Component component)
{
    return fmu_status(component, fmu_exit_initialization(component));
}

fmi2Status fmi2Terminate(fmi2Component component) { return fmu_status(component, true); }
fmi2Status fmi2Reset(fmi2Component component) { return fmu_status(component, fmu_reset(component)); }

fmi2Status fmi2GetReal(fmi2Component component, const fmi2ValueReference references[], size_t count, fmi2Real values[])
{
    return fmu_status(component, fmu_get(component, references, count, values));
}

fmi2Status fmi2SetReal(fmi2Component component, const fmi2ValueReference references[], size_t count,
                       const fmi2Real values[])
{
    return fmu_status(component, fmu_set(component, references, count, values));
}

#define NONE_OF(TYPE)                                                                                                  \
    fmi2Status fmi2Get##TYPE(fmi2Component component, const fmi2ValueReference references[], size_t count,             \
                             fmi2##TYPE values[])                                                                      \
    {                                                                                                                  \
        (void)references, (void)values;                                                                                \
        return fmu_status(component, fmu_none(component, count, "variables of this type"));                            \
    }                                                                                                                  \
    fmi2Status fmi2Set##TYPE(fmi2Component component, const fmi2ValueReference references[], size_t count,             \
                             const fmi2##TYPE values[])                                                                \
    {                                                                                                                  \
        (void)references, (void)values;                                                                                \
        return fmu_status(component, fmu_none(component, count, "variables of this type"));                            \
    }
NONE_OF(Integer)
NONE_OF(Boolean)
NONE_OF(String)

fmi2Status fmi2GetFMUstate(fmi2Component component, fmi2FMUstate *state)
{
    return fmu_status(component, fmu_save(component, state));
}

fmi2Status fmi2SetFMUstate(fmi2Component component, fmi2FMUstate state)
{
    return fmu_status(component, fmu_restore(component, state));
}

fmi2Status fmi2FreeFMUstate(fmi2Component component, fmi2FMUstate *state)
{
    free(*state);
    *state = NULL;
    return fmu_status(component, true);
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component component, fmi2FMUstate state, size_t *size)
{
    (void)state;
    *size = sizeof(fmu_content);
    return fmu_status(component, true);
}

fmi2Status fmi2SerializeFMUstate(fmi2Component component, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    return fmu_status(component, fmu_write(component, state, bytes, size));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component component, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    return fmu_status(component, fmu_copy(component, bytes, size, state));
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component component, const fmi2ValueReference unknown[], size_t unknowns,
                                        const fmi2ValueReference known[], size_t knowns, const fmi2Real seed[],
                                        fmi2Real derivative[])
{
    (void)unknown, (void)known, (void)knowns, (void)seed, (void)derivative;
    return fmu_status(component, fmu_none(component, unknowns, "directional derivatives"));
}

/* Model exchange */

fmi2Status fmi2EnterEventMode(fmi2Component component) { return fmu_status(component, true); }
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component component) { return fmu_status(component, true); }

fmi2Status fmi2NewDiscreteStates(fmi2Component component, fmi2EventInfo *info)
{
    memset(info, 0, sizeof *info);
    return fmu_status(component, true);
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component component, fmi2Boolean keep, fmi2Boolean *event,
                                       fmi2Boolean *terminate)
{
    (void)keep;
    *event = *terminate = fmi2False;
    return fmu_status(component, fmu_complete_step(component));
}

fmi2Status fmi2SetTime(fmi2Component component, fmi2Real time)
{
    return fmu_status(component, fmu_set_time(component, time));
}

fmi2Status fmi2SetContinuousStates(fmi2Component component, const fmi2Real values[], size_t count)
{
    return fmu_status(component, fmu_set_states(component, values, count));
}

fmi2Status fmi2GetContinuousStates(fmi2Component component, fmi2Real values[], size_t count)
{
    return fmu_status(component, fmu_get_states(component, values, count));
}

fmi2Status fmi2GetDerivatives(fmi2Component component, fmi2Real values[], size_t count)
{
    return fmu_status(component, fmu_get_rates(component, values, count));
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component component, fmi2Real values[], size_t count)
{
    return fmu_status(component, fmu_get_nominals(component, values, count));
}

fmi2Status fmi2GetEventIndicators(fmi2Component component, fmi2Real values[], size_t count)
{
    (void)values;
    return fmu_status(component, fmu_none(component, count, "event indicators"));
}

/* Co-simulation */

fmi2Status fmi2DoStep(fmi2Component component, fmi2Real time, fmi2Real step, fmi2Boolean final)
{
    (void)final;
    return fmu_status(component, fmu_step(component, time, step));
}

fmi2Status fmi2CancelStep(fmi2Component component)
{
    return fmu_status(component, fmu_none(component, 1, "steps computed asynchronously"));
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component component, const fmi2ValueReference references[], size_t count,
                                       const fmi2Integer orders[], const fmi2Real values[])
{
    (void)references, (void)orders, (void)values;
    return fmu_status(component, fmu_none(component, count, "derivatives of inputs"));
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component component, const fmi2ValueReference references[], size_t count,
                                        const fmi2Integer orders[], fmi2Real values[])
{
    (void)references, (void)orders, (void)values;
    return fmu_status(component, fmu_none(component, count, "derivatives of outputs"));
}

#define NO_STATUS(NAME, TYPE)                                                                                          \
    fmi2Status fmi2Get##NAME(fmi2Component component, const fmi2StatusKind kind, TYPE *value)                          \
    {                                                                                                                  \
        (void)component, (void)kind, (void)value;                                                                      \
        return fmi2Discard;                                                                                            \
    }
NO_STATUS(Status, fmi2Status)
NO_STATUS(RealStatus, fmi2Real)
NO_STATUS(IntegerStatus, fmi2Integer)
NO_STATUS(BooleanStatus, fmi2Boolean)
NO_STATUS(StringStatus, fmi2String)
