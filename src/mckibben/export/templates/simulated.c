/* A simulated joint in place of sensors and valves. */
#include "firmware.h"
#include "plant.h"
#include "simulated.h"

#include <string.h>

static plant joint;
static plant_weight on_limb;
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
    values[0] = joint.state.angle + 1e-6 * noise();
<% for takes in air %>
    values[${loop.index}] = ${"joint.state.pressures_%d + 100 * noise()" % loop.index0 if takes else "0"};
<% endfor %>
}

void board_command(const double commands[COMMANDS]) { memcpy(commands_sent, commands, sizeof commands_sent); }

void board_vent(bool open)
{
    if (open)
        memset(commands_sent, 0, sizeof commands_sent);
}

void simulated_begin(double mass, double distance)
{
    on_limb.mass = mass;
    on_limb.distance = distance;
    plant_defaults(&joint);
    plant_init(&joint);
}

void simulated_advance(void)
{
    plant_commands commands;
    commands._0 = commands_sent[0];
    commands._1 = commands_sent[1];
    plant_advance(&joint, &commands, &on_limb);
    ++periods;
}
