// The controller of "${title}" on an Arduino or Teensy. Fill in the three functions for your sensors and valves.
#include "${name}.h"

static const uint32_t PERIOD = ${microseconds}; // us, control_period
static ${name} controller;
static uint32_t next;

static ${name}_measurement measure(); // angle in rad, gauge pressures in Pa
static ${name}_setpoint reference(uint32_t milliseconds); // angle in rad, stiffness in N*m/rad
static void apply(const ${name}_commands &commands); // gauge pressures in Pa; limit them to your valves

void setup()
{
    ${name}_defaults(&controller);
    ${name}_measurement first = measure();
    while (!${name}_init(&controller, &first))
        first = measure();
    next = micros();
}

void loop()
{
    if ((int32_t)(micros() - next) < 0)
        return;
    next += PERIOD;
    ${name}_measurement measurement = measure();
    ${name}_setpoint setpoint = reference(millis());
    ${name}_commands commands;
    ${name}_telemetry telemetry;
    ${name}_step(&controller, &setpoint, &measurement, &commands, &telemetry);
    apply(commands); // the last ones if a number was not finite: count telemetry.held, and vent after some in a row
}

#error "fill in measure, reference and apply, then remove this line"
