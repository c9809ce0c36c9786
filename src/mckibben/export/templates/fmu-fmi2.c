/* FMI 2.0 of "$title": the functions of the standard. */
#include "fmi2Functions.h"

typedef fmi2ValueReference fmu_reference;
#include "fmu-instance.h"

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
