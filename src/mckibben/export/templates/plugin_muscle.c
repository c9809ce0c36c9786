
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
#if $activations
    memcpy(given.act, act, sizeof given.act);
#endif
#if $anchors
    if (state[0] == UNSET) {
        ${name}_first$k first;
        ${name}_unset$k(model, &given, &first);
        memcpy(state + 2, first.anchors, sizeof first.anchors);
    }
    memcpy(given.anchors, state + 2, sizeof given.anchors);
#endif
#if $slips
    if (state[0] == STEPPED) {
        ${name}_after$k after;
        given.command = state[1];
        ${name}_settled$k(model, &given, &after);
#if $activations
        memcpy(act, after.act, sizeof after.act);
        memcpy(given.act, after.act, sizeof after.act);
#endif
#if $anchors
        memcpy(state + 2, after.anchors, sizeof after.anchors);
        memcpy(given.anchors, after.anchors, sizeof after.anchors);
#endif
        given.command = command(m, d, i);
    }
    state[0] = SETTLED;
#endif
    return given;
}

static void act_dot$k(const $name *model, const mjModel *m, mjData *d, int i, mjtNum *state)
{
    ${name}_input$k given = input$k(model, m, d, i, state);
    (void)given;
#if $rates
    ${name}_rate$k found;
    ${name}_rates$k(model, &given, &found);
    memcpy(d->act_dot + m->actuator_actadr[i], found.act, $rates * sizeof(mjtNum));
#endif
}

static void force$k(const $name *model, const mjModel *m, mjData *d, int i, mjtNum *state)
{
    ${name}_input$k given = input$k(model, m, d, i, state);
    d->actuator_force[i] = ${name}_force$k(model, &given);
}
