/* FMI 3.0 of "$title": the functions of the standard. */
#include "fmi3Functions.h"

typedef fmi3ValueReference fmu_reference;
#include "fmu-instance.h"

typedef struct {
    fmu_instance instance; /* first, so that an instance of the standard is one */
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} fmu_component;

static fmi3Status fmu_status(fmi3Instance instance, bool done)
{
    const fmu_component *self = instance;
    if (!done && self->log)
        self->log(self->environment, fmi3Error, "logStatusError", self->instance.message);
    return done ? fmi3OK : fmi3Error;
}

/* Whether the numbers of values and references are equal; all variables are scalars. */
static bool fmu_check_values(fmu_instance *self, size_t count, size_t values)
{
    return count == values || fmu_fail(self, "%u values of %u variables", (unsigned)values, (unsigned)count);
}

static fmi3Instance fmu_instantiate(const char *token, bool model_exchange, fmi3InstanceEnvironment environment,
                                    fmi3LogMessageCallback log)
{
    fmu_component *self = calloc(1, sizeof *self);
    if (!self)
        return NULL;
    self->environment = environment;
    self->log = log;
    if (fmu_status(self, fmu_begin(&self->instance, token, model_exchange)) == fmi3OK)
        return self;
    free(self);
    return NULL;
}

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log)
{
    (void)name, (void)resources, (void)visible, (void)logging;
    return fmu_instantiate(token, true, environment, log);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference required[], size_t count,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update)
{
    (void)name, (void)resources, (void)visible, (void)logging;
    (void)events, (void)early, (void)required, (void)count, (void)update;
    return fmu_instantiate(token, false, environment, log);
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean logging,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                               fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)update, (void)lock, (void)unlock;
    if (log)
        log(environment, fmi3Error, "logStatusError", "there is no scheduled execution");
    return NULL;
}

void fmi3FreeInstance(fmi3Instance instance) { free(instance); }

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t count, const fmi3String categories[])
{
    (void)on, (void)count, (void)categories;
    return fmu_status(instance, true);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean tolerance_given, fmi3Float64 tolerance,
                                       fmi3Float64 begin, fmi3Boolean end_given, fmi3Float64 end)
{
    (void)tolerance_given, (void)tolerance, (void)end_given, (void)end;
    return fmu_status(instance, fmu_set_time(instance, begin) && fmu_enter_initialization(instance));
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    return fmu_status(instance, fmu_exit_initialization(instance));
}

fmi3Status fmi3Terminate(fmi3Instance instance) { return fmu_status(instance, true); }
fmi3Status fmi3Reset(fmi3Instance instance) { return fmu_status(instance, fmu_reset(instance)); }

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                          fmi3Float64 values[], size_t size)
{
    return fmu_status(instance, fmu_check_values(instance, count, size) && fmu_get(instance, references, count, values));
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                          const fmi3Float64 values[], size_t size)
{
    return fmu_status(instance, fmu_check_values(instance, count, size) && fmu_set(instance, references, count, values));
}

#define NONE_OF(TYPE)                                                                                                  \
    fmi3Status fmi3Get##TYPE(fmi3Instance instance, const fmi3ValueReference references[], size_t count,               \
                             fmi3##TYPE values[], size_t size)                                                         \
    {                                                                                                                  \
        (void)references, (void)values, (void)size;                                                                    \
        return fmu_status(instance, fmu_none(instance, count, "variables of this type"));                              \
    }                                                                                                                  \
    fmi3Status fmi3Set##TYPE(fmi3Instance instance, const fmi3ValueReference references[], size_t count,               \
                             const fmi3##TYPE values[], size_t size)                                                   \
    {                                                                                                                  \
        (void)references, (void)values, (void)size;                                                                    \
        return fmu_status(instance, fmu_none(instance, count, "variables of this type"));                              \
    }
NONE_OF(Float32)
NONE_OF(Int8)
NONE_OF(UInt8)
NONE_OF(Int16)
NONE_OF(UInt16)
NONE_OF(Int32)
NONE_OF(UInt32)
NONE_OF(Int64)
NONE_OF(UInt64)
NONE_OF(Boolean)
NONE_OF(String)

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference references[], size_t count, size_t sizes[],
                         fmi3Binary values[], size_t size)
{
    (void)references, (void)sizes, (void)values, (void)size;
    return fmu_status(instance, fmu_none(instance, count, "variables of this type"));
}

fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                         const size_t sizes[], const fmi3Binary values[], size_t size)
{
    (void)references, (void)sizes, (void)values, (void)size;
    return fmu_status(instance, fmu_none(instance, count, "variables of this type"));
}

/* Functions of clocks that take one array, and those that take two. */
#define NO_CLOCKS(NAME, TYPE)                                                                                          \
    fmi3Status fmi3##NAME(fmi3Instance instance, const fmi3ValueReference references[], size_t count, TYPE values[])   \
    {                                                                                                                  \
        (void)references, (void)values;                                                                                \
        return fmu_status(instance, fmu_none(instance, count, "clocks"));                                              \
    }
#define NO_CLOCKS_OF_TWO(NAME, TYPE, OTHER)                                                                            \
    fmi3Status fmi3##NAME(fmi3Instance instance, const fmi3ValueReference references[], size_t count, TYPE values[],   \
                          OTHER others[])                                                                              \
    {                                                                                                                  \
        (void)references, (void)values, (void)others;                                                                  \
        return fmu_status(instance, fmu_none(instance, count, "clocks"));                                              \
    }
NO_CLOCKS(GetClock, fmi3Clock)
NO_CLOCKS(SetClock, const fmi3Clock)
NO_CLOCKS(GetShiftDecimal, fmi3Float64)
NO_CLOCKS(SetShiftDecimal, const fmi3Float64)
NO_CLOCKS(SetIntervalDecimal, const fmi3Float64)
NO_CLOCKS_OF_TWO(GetShiftFraction, fmi3UInt64, fmi3UInt64)
NO_CLOCKS_OF_TWO(SetShiftFraction, const fmi3UInt64, const fmi3UInt64)
NO_CLOCKS_OF_TWO(SetIntervalFraction, const fmi3UInt64, const fmi3UInt64)
NO_CLOCKS_OF_TWO(GetIntervalDecimal, fmi3Float64, fmi3IntervalQualifier)

fmi3Status fmi3GetIntervalFraction(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                                   fmi3UInt64 counters[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
{
    (void)references, (void)counters, (void)resolutions, (void)qualifiers;
    return fmu_status(instance, fmu_none(instance, count, "clocks"));
}

fmi3Status fmi3ActivateModelPartition(fmi3Instance instance, fmi3ValueReference clock, fmi3Float64 time)
{
    (void)clock, (void)time;
    return fmu_status(instance, fmu_none(instance, 1, "clocks"));
}

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance instance, fmi3ValueReference reference, size_t *count)
{
    (void)reference, (void)count;
    return fmu_status(instance, fmu_none(instance, 1, "dependencies of elements"));
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance instance, fmi3ValueReference dependent, size_t elements[],
                                       fmi3ValueReference independent[], size_t others[], fmi3DependencyKind kinds[],
                                       size_t count)
{
    (void)dependent, (void)elements, (void)independent, (void)others, (void)kinds;
    return fmu_status(instance, fmu_none(instance, count, "dependencies of elements"));
}

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    return fmu_status(instance, fmu_save(instance, state));
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state)
{
    return fmu_status(instance, fmu_restore(instance, state));
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    free(*state);
    *state = NULL;
    return fmu_status(instance, true);
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState state, size_t *size)
{
    (void)state;
    *size = sizeof(fmu_content);
    return fmu_status(instance, true);
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    return fmu_status(instance, fmu_write(instance, state, bytes, size));
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    return fmu_status(instance, fmu_copy(instance, bytes, size, state));
}

#define NO_DERIVATIVES(NAME)                                                                                           \
    fmi3Status fmi3Get##NAME(fmi3Instance instance, const fmi3ValueReference unknown[], size_t unknowns,               \
                             const fmi3ValueReference known[], size_t knowns, const fmi3Float64 seed[], size_t seeds,  \
                             fmi3Float64 derivative[], size_t derivatives)                                             \
    {                                                                                                                  \
        (void)unknown, (void)known, (void)knowns, (void)seed, (void)seeds, (void)derivative, (void)derivatives;        \
        return fmu_status(instance, fmu_none(instance, unknowns, "directional and adjoint derivatives"));              \
    }
NO_DERIVATIVES(DirectionalDerivative)
NO_DERIVATIVES(AdjointDerivative)

fmi3Status fmi3EnterConfigurationMode(fmi3Instance instance)
{
    return fmu_status(instance, fmu_none(instance, 1, "structural parameters"));
}

fmi3Status fmi3ExitConfigurationMode(fmi3Instance instance)
{
    return fmu_status(instance, fmu_none(instance, 1, "structural parameters"));
}

/* Model exchange */

fmi3Status fmi3EnterEventMode(fmi3Instance instance) { return fmu_status(instance, true); }
fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance) { return fmu_status(instance, true); }
fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance) { return fmu_status(instance, true); }

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *again, fmi3Boolean *terminate,
                                    fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *planned, fmi3Float64 *next)
{
    *again = *terminate = *nominals = *values = *planned = fmi3False;
    *next = 0.0;
    return fmu_status(instance, true);
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean keep, fmi3Boolean *event,
                                       fmi3Boolean *terminate)
{
    (void)keep;
    *event = *terminate = fmi3False;
    return fmu_status(instance, fmu_complete_step(instance));
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time)
{
    return fmu_status(instance, fmu_set_time(instance, time));
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 values[], size_t count)
{
    return fmu_status(instance, fmu_set_states(instance, values, count));
}

fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 values[], size_t count)
{
    return fmu_status(instance, fmu_get_states(instance, values, count));
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 values[], size_t count)
{
    return fmu_status(instance, fmu_get_rates(instance, values, count));
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 values[], size_t count)
{
    return fmu_status(instance, fmu_get_nominals(instance, values, count));
}

fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 values[], size_t count)
{
    (void)values;
    return fmu_status(instance, fmu_none(instance, count, "event indicators"));
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *count)
{
    *count = 0;
    return fmu_status(instance, true);
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *count)
{
    *count = STATES;
    return fmu_status(instance, true);
}

/* Co-simulation */

fmi3Status fmi3EnterStepMode(fmi3Instance instance) { return fmu_status(instance, true); }

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance, const fmi3ValueReference references[], size_t count,
                                    const fmi3Int32 orders[], fmi3Float64 values[], size_t size)
{
    (void)references, (void)orders, (void)values, (void)size;
    return fmu_status(instance, fmu_none(instance, count, "derivatives of outputs"));
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 time, fmi3Float64 step, fmi3Boolean keep, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *reached)
{
    (void)keep;
    const bool done = fmu_step(instance, time, step);
    *event = *terminate = *early = fmi3False;
    *reached = done ? time + step : time;
    return fmu_status(instance, done);
}
