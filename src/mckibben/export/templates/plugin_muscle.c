
static ${name}_input$k input$k(const $name *model, const mjModel *m, mjData *d, int i, mjtNum *state)
{
    ${name}_input$k given;
    mjtNum *act = d->act + (m->actuator_actadr[i] < 0 ? 0 : m->actuator_actadr[i]);
    given.length = d->actuator_length[i];
    given.velocity = d->actuator_velocity[i];
    given.command = command(m, d, i);
    (void)act;
    (void)state;
    (void)model;
$load
    return given;
}

static void act_dot$k(const $name *model, const mjModel *m, mjData *d, int i, mjtNum *state)
{
    ${name}_input$k given = input$k(model, m, d, i, state);
    (void)given;
$rates
}

static void force$k(const $name *model, const mjModel *m, mjData *d, int i, mjtNum *state)
{
    ${name}_input$k given = input$k(model, m, d, i, state);
    d->actuator_force[i] = ${name}_force$k(model, &given);
}
