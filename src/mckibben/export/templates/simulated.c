/* Simulated joints in place of sensors and valves. */
#include "firmware.h"
#include "plant.h"
#include "simulated.h"

#include <string.h>

static plant joint;
<% if weight %>
static plant_weight on_limb;
<% endif %>
static double commands_sent[COMMANDS], draw = 0.5;
static uint32_t periods;

uint32_t board_time(void) { return periods * (uint32_t)PERIOD_US; }

static double noise(void) /* logistic map, in -1..1: sensors that stand still look frozen */
{
    draw = 3.99 * draw * (1 - draw);
    return 2 * draw - 1;
}

void board_measure(double values[MEASUREMENTS])
{
    memset(values, 0, sizeof(double) * MEASUREMENTS);
<% for member in plant_angles %>
    values[${loop.index0}] = joint.state.${member} + 1e-6 * noise();
<% endfor %>
<% for takes in air %>
    values[${plant_angles | length + loop.index0}] = ${"joint.state.pressures_%d + 100 * noise()" % loop.index0 if takes else "0"};
<% endfor %>
}

void board_command(const double commands[COMMANDS]) { memcpy(commands_sent, commands, sizeof commands_sent); }

void board_vent(bool open)
{
    if (open)
        memset(commands_sent, 0, sizeof commands_sent);
}

void simulated_begin(${"double mass, double distance" if weight else "void"})
{
<% if weight %>
    on_limb.mass = mass;
    on_limb.distance = distance;
<% endif %>
    plant_defaults(&joint);
    plant_init(&joint);
}

void simulated_advance(void)
{
    plant_commands commands;
<% for _ in air %>
    commands._${loop.index0} = commands_sent[${loop.index0}];
<% endfor %>
    plant_advance(&joint, &commands${", &on_limb" if weight else ""});
    ++periods;
}
