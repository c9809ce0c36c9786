// Runs the exported knee over samples with faults; capitals are replaced by the test.
#include "knee.h"
#include <stdio.h>
int main(void) /* a sample in each row of the input; commands, status and fault in each row of the output */
{
    static knee self;
    knee_setpoint setpoint;
    knee_measurement measurement;
    knee_commands commands;
    knee_telemetry telemetry;
    double row[ROW], out[4];
    int first = 1;
    knee_defaults(&self);
    while (fread(row, sizeof row, 1, stdin)) {
        ASSIGN
        if (first) {
            first = knee_init(&self, (NUMBER)(1.01 * PERIOD), &measurement);
            knee_step(&self, &setpoint, &measurement, &commands, &telemetry);
            if (first || telemetry.status != 4 || commands.pressure1 > 0 || commands.pressure2 > 0)
                return 1;
            if (!knee_init(&self, (NUMBER)PERIOD, &measurement))
                return 2;
            first = 0;
        }
        if (row[ROW - 1] > 0)
            knee_hold(&self, &commands, &telemetry);
        else
            knee_step(&self, &setpoint, &measurement, &commands, &telemetry);
        out[0] = (double)commands.pressure1, out[1] = (double)commands.pressure2;
        out[2] = (double)telemetry.status, out[3] = (double)telemetry.fault;
        fwrite(out, sizeof out, 1, stdout);
    }
    return 0;
}
