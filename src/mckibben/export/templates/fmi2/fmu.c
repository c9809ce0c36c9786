/* FMI 2.0 of "$title": the functions of the standard around $name.c. */
#include "$name.h"

#include "fmi2Functions.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { VARIABLES = $variables, STATES = $states, MODEL_EXCHANGE = $model_exchange, SAMPLED = $sampled };
static const double LONGEST = $longest; /* s, of a call of advance; of a sampled function its period */

typedef enum { BEFORE, INITIALIZATION, RUNNING } mode;

typedef struct {
    $name model;
$structures
    mode mode;
    bool changed; /* parameters, since they were prepared */
    bool fresh;   /* results are those of parameters, state and inputs */
} content;

typedef struct {
    content content;
    fmi2CallbackFunctions callbacks;
    char *name;
} instance;

/* p parameter, s state that has a start value, c other continuous state, i input, o result */
typedef struct {
    size_t place;
    char kind;
    double start, nominal;
} variable;

static const variable VARIABLE[VARIABLES] = {
$table
};
static const fmi2ValueReference STATE[] = {$state_references}, RATE[] = {$rate_references};

static double *at(content *self, fmi2ValueReference reference)
{
    return (double *)(void *)((char *)self + VARIABLE[reference].place);
}

$calls
static void refresh(content *self)
{
    if (self->changed)
        ${name}_prepare(&self->model);
    if (self->changed || !self->fresh) {
        if (self->mode != RUNNING)
            initialize(self);
        results(self);
    }
    self->changed = false;
    self->fresh = true;
}

static void start(content *self)
{
    fmi2ValueReference number;
    memset(self, 0, sizeof *self);
    ${name}_defaults(&self->model);
    for (number = 0; number < VARIABLES; ++number)
        if (VARIABLE[number].kind == 's' || VARIABLE[number].kind == 'i')
            *at(self, number) = VARIABLE[number].start;
}

static fmi2Status fail(const instance *self, const char *text, ...)
{
    char message[256];
    va_list arguments;
    va_start(arguments, text);
    vsnprintf(message, sizeof message, text, arguments);
    va_end(arguments);
    if (self->callbacks.logger)
        self->callbacks.logger(self->callbacks.componentEnvironment, self->name, fmi2Error, "logStatusError", "%s", message);
    return fmi2Error;
}

#define CONTENT (&((instance *)component)->content)

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    instance *self = calloc(1, sizeof *self);
    const size_t length = name ? strlen(name) + 1 : 0;
    (void)resources, (void)visible, (void)logging;
    if (!self || !callbacks || !length || !(self->name = malloc(length))) {
        free(self);
        return NULL;
    }
    memcpy(self->name, name, length);
    self->callbacks = *callbacks;
    start(&self->content);
    if (guid && strcmp(guid, "$guid") == 0 && (MODEL_EXCHANGE || type == fmi2CoSimulation))
        return self;
    fail(self, "the identifier is that of another FMU, or this one is for co-simulation only");
    free(self->name);
    free(self);
    return NULL;
}

void fmi2FreeInstance(fmi2Component component)
{
    if (component) {
        free(((instance *)component)->name);
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
    (void)component, (void)tolerance_given, (void)tolerance, (void)begin, (void)end_given, (void)end;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component component)
{
    CONTENT->mode = INITIALIZATION;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component component)
{
    CONTENT->fresh = false;
    refresh(CONTENT);
    CONTENT->mode = RUNNING;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component component)
{
    (void)component;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component component)
{
    start(CONTENT);
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component component, const fmi2ValueReference references[], size_t count, fmi2Real values[])
{
    size_t number;
    for (number = 0; number < count; ++number) {
        if (references[number] >= VARIABLES)
            return fail(component, "there is no variable %u", references[number]);
        if (strchr("oc", VARIABLE[references[number]].kind))
            refresh(CONTENT);
        values[number] = *at(CONTENT, references[number]);
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component component, const fmi2ValueReference references[], size_t count,
                       const fmi2Real values[])
{
    size_t number;
    for (number = 0; number < count; ++number) {
        const fmi2ValueReference reference = references[number];
        const char kind = reference < VARIABLES ? VARIABLE[reference].kind : 0;
        if (kind != 'p' && kind != 'i' && !(kind == 's' && CONTENT->mode != RUNNING))
            return fail(component, "variable %u cannot be set now", reference);
        *at(CONTENT, reference) = values[number];
        CONTENT->changed = CONTENT->changed || kind == 'p';
        CONTENT->fresh = false;
    }
    return fmi2OK;
}

#define NONE_OF(TYPE)                                                                                                  \
    fmi2Status fmi2Get##TYPE(fmi2Component component, const fmi2ValueReference references[], size_t count,             \
                             fmi2##TYPE values[])                                                                      \
    {                                                                                                                  \
        (void)references, (void)values;                                                                                \
        return count ? fail(component, "there are no variables of this type") : fmi2OK;                                \
    }                                                                                                                  \
    fmi2Status fmi2Set##TYPE(fmi2Component component, const fmi2ValueReference references[], size_t count,             \
                             const fmi2##TYPE values[])                                                                \
    {                                                                                                                  \
        (void)references, (void)values;                                                                                \
        return count ? fail(component, "there are no variables of this type") : fmi2OK;                                \
    }
NONE_OF(Integer)
NONE_OF(Boolean)
NONE_OF(String)

fmi2Status fmi2GetFMUstate(fmi2Component component, fmi2FMUstate *state)
{
    if (!*state && !(*state = malloc(sizeof(content))))
        return fail(component, "out of memory");
    memcpy(*state, CONTENT, sizeof(content));
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component component, fmi2FMUstate state)
{
    memcpy(CONTENT, state, sizeof(content));
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component component, fmi2FMUstate *state)
{
    (void)component;
    free(*state);
    *state = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component component, fmi2FMUstate state, size_t *size)
{
    (void)component, (void)state;
    *size = sizeof(content);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component component, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    if (size < sizeof(content))
        return fail(component, "a state has %u bytes", (unsigned)sizeof(content));
    memcpy(bytes, state, sizeof(content));
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component component, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    if (size != sizeof(content))
        return fail(component, "a state has %u bytes", (unsigned)sizeof(content));
    if (!*state && !(*state = malloc(sizeof(content))))
        return fail(component, "out of memory");
    memcpy(*state, bytes, size);
    return fmi2OK;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component component, const fmi2ValueReference unknown[], size_t unknowns,
                                        const fmi2ValueReference known[], size_t knowns, const fmi2Real seed[],
                                        fmi2Real derivative[])
{
    (void)unknown, (void)unknowns, (void)known, (void)knowns, (void)seed, (void)derivative;
    return fail(component, "directional derivatives are not provided");
}

/* Model exchange */

fmi2Status fmi2EnterEventMode(fmi2Component component)
{
    (void)component;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component component, fmi2EventInfo *info)
{
    (void)component;
    memset(info, 0, sizeof *info);
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component component)
{
    (void)component;
    return fmi2OK;
}

/* Friction follows the motion that is left behind; no force changes by it, so this is no event. */
fmi2Status fmi2CompletedIntegratorStep(fmi2Component component, fmi2Boolean keep, fmi2Boolean *event,
                                       fmi2Boolean *terminate)
{
    (void)keep;
    refresh(CONTENT);
    project(CONTENT);
    CONTENT->fresh = false;
    *event = *terminate = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component component, fmi2Real time)
{
    (void)component, (void)time;
    return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component component, const fmi2Real values[], size_t count)
{
    size_t number;
    if (count != STATES)
        return fail(component, "there are %d states", STATES);
    for (number = 0; number < count; ++number)
        *at(CONTENT, STATE[number]) = values[number];
    CONTENT->fresh = false;
    return fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component component, fmi2Real values[], size_t count)
{
    return count == STATES ? fmi2GetReal(component, STATE, count, values) : fail(component, "there are %d states", STATES);
}

fmi2Status fmi2GetDerivatives(fmi2Component component, fmi2Real values[], size_t count)
{
    return count == STATES ? fmi2GetReal(component, RATE, count, values) : fail(component, "there are %d states", STATES);
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component component, fmi2Real values[], size_t count)
{
    size_t number;
    if (count != STATES)
        return fail(component, "there are %d states", STATES);
    for (number = 0; number < count; ++number)
        values[number] = VARIABLE[STATE[number]].nominal;
    return fmi2OK;
}

fmi2Status fmi2GetEventIndicators(fmi2Component component, fmi2Real values[], size_t count)
{
    (void)values;
    return count ? fail(component, "there are no event indicators") : fmi2OK;
}

/* Co-simulation */

fmi2Status fmi2DoStep(fmi2Component component, fmi2Real time, fmi2Real step, fmi2Boolean final)
{
    content *self = CONTENT;
    const double count = SAMPLED ? floor(step / LONGEST + 0.5) : fmax(ceil(step / LONGEST - 1e-9), 1.0);
    double number;
    fmi2ValueReference state;
    (void)final;
    if (SAMPLED && (count < 1 || fabs(step - count * LONGEST) > 1e-6 * LONGEST))
        return fail(component, "a step of %g s is no whole number of periods of %g s", step, LONGEST);
    if (!(step >= 0))
        return fail(component, "a step of %g s", step);
    refresh(self); /* of a sampled function: results of the inputs at the beginning, held until others are set */
    for (number = 0; number < count && step > 0; ++number)
        advance(self, step / count);
    self->fresh = SAMPLED;
    for (state = 0; state < VARIABLES; ++state)
        if (strchr("sc", VARIABLE[state].kind) && !isfinite(*at(self, state)))
            return fail(component, "variable %u is not finite after %g s", state, time + step);
    return fmi2OK;
}

fmi2Status fmi2CancelStep(fmi2Component component) { return fail(component, "no step is computed asynchronously"); }

fmi2Status fmi2SetRealInputDerivatives(fmi2Component component, const fmi2ValueReference references[], size_t count,
                                       const fmi2Integer orders[], const fmi2Real values[])
{
    (void)references, (void)orders, (void)values;
    return count ? fail(component, "inputs are constant over a step") : fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component component, const fmi2ValueReference references[], size_t count,
                                        const fmi2Integer orders[], fmi2Real values[])
{
    (void)references, (void)orders, (void)values;
    return count ? fail(component, "derivatives of outputs are not provided") : fmi2OK;
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
