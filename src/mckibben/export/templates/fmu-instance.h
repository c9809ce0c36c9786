/* An instance of "$title" for the FMI functions: variables of $name.c, start values, steps and saved states.
 * Include after the standard's header and fmu_reference, the type of its value references. */
#include "$name.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { VARIABLES = $variables, STATES = $states, MODEL_EXCHANGE = $model_exchange, SAMPLED = $sampled };
static const double LONGEST = $longest; /* s, per call of advance; the period of a sampled function */

typedef enum { BEFORE, INITIALIZATION, RUNNING } fmu_mode;

typedef struct {
    $name model;
$structures
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
$table
};
static const fmu_reference STATE[] = {$state_references}, RATE[] = {$rate_references};

static double *fmu_at(fmu_content *self, fmu_reference reference)
{
    return (double *)(void *)((char *)self + VARIABLE[reference].place);
}

$calls
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
    fmu_reference number;
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

static bool fmu_get(fmu_instance *self, const fmu_reference references[], size_t count, double values[])
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

static bool fmu_set(fmu_instance *self, const fmu_reference references[], size_t count, const double values[])
{
    size_t number;
    for (number = 0; number < count; ++number) {
        const fmu_reference reference = references[number];
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
    fmu_reference variable;
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
