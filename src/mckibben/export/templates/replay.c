/* Replays a recorded run: compares the commands of ${name}_step with the recorded ones, and times the steps.
 *     ./replay replay.csv [steps to time]
 * Exit code 1 if the error of a command exceeds the tolerance, and what rounding explains: a controller that is unstable
 * without its plant, which a replay lacks, amplifies it. That is measured with a second controller, whose measurements
 * differ by a thousandth of the tolerance; where it differs by a thousandth of the largest command, the comparison ends.
 */
#include "${name}.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { ROWS = ${rows}, COLUMNS = ${columns | length} };
static const double TOLERANCE = ${tolerance}; /* of a command, relative to the largest one */

static double table[ROWS][COLUMNS], deviation, rounding, largest;
static int wrong;

static int read_table(const char *path)
{
    FILE *file = fopen(path, "r");
    int row, column, rest = 0;
    if (!file) {
        perror(path);
        return 0;
    }
    while ((rest = fgetc(file)) != '\n' && rest != EOF) /* column names */
        ;
    for (row = 0; row < ROWS; ++row)
        for (column = 0; column < COLUMNS; ++column)
            if (fscanf(file, column ? ",%lf" : "%lf", &table[row][column]) != 1) {
                fprintf(stderr, "%s: row %d, column %d is not a number\n", path, row + 1, column + 1);
                fclose(file);
                return 0;
            }
    fclose(file);
    return 1;
}

static void inputs(const double *row, double change, ${name}_setpoint *setpoint, ${name}_measurement *measurement)
{
<% for part, member in columns if part != "commands" %>
    ${part}->${member} = <% if part == "setpoint" %>row[${loop.index0}]<% else %>(${real})(row[${loop.index0}] * (1 + change))<% endif %>;
<% endfor %>
}

static void compare(double command, double changed, double recorded)
{
    const double error = fabs(command - recorded);
    deviation = error != error ? HUGE_VAL : fmax(deviation, error); /* fmax drops a NaN */
    rounding = fmax(rounding, fabs(command - changed));
    largest = fmax(largest, fabs(recorded));
}

int main(int count, char **arguments)
{
    static ${name} controller, other;
    ${name}_setpoint setpoint;
    ${name}_measurement measurement;
    static ${name}_commands commands, changed;
    ${name}_telemetry telemetry;
    const long steps = count > 2 ? strtol(arguments[2], NULL, 10) : 1000000;
    const double *row;
    int number, held = 0;
    long step;
    clock_t start;
    if (count < 2 || !read_table(arguments[1]))
        return 2;
    ${name}_defaults(&controller);
    ${name}_defaults(&other);
    inputs(table[0], 0, &setpoint, &measurement);
    ${name}_init(&controller, (${real})${seconds}, &measurement);
    ${name}_init(&other, (${real})${seconds}, &measurement);
    for (number = 1; number < ROWS && rounding <= 1e-3 * largest; ++number) {
        row = table[number];
        inputs(row, TOLERANCE / 1000, &setpoint, &measurement);
        ${name}_step(&other, &setpoint, &measurement, &changed, &telemetry);
        inputs(row, 0, &setpoint, &measurement);
        ${name}_step(&controller, &setpoint, &measurement, &commands, &telemetry);
        held += telemetry.fault != 0;
<% for part, member in columns if part == "commands" %>
        compare((double)commands.${member}, (double)changed.${member}, row[${first_command + loop.index0}]);
<% endfor %>
        wrong = wrong || !(deviation <= fmax(TOLERANCE * largest, rounding));
    }
    printf("%d of %d steps: largest deviation of a command %.3g Pa, %.3g of the largest command\n", number - 1, ROWS - 1,
           deviation, deviation / largest);
    if (deviation > TOLERANCE * largest)
        printf("a change of the measurements by %.0e of their size changes a command by %.3g Pa: %s\n", TOLERANCE / 1000,
               rounding, wrong ? "the program is wrong" : "without its plant this controller amplifies rounding");
    if (held)
        printf("%d samples were not used: the limits in ${name}_defaults do not fit this run\n", held);
    start = clock();
    for (step = 0; step < steps; ++step) {
        inputs(table[1 + step % (ROWS - 1)], 0, &setpoint, &measurement);
        ${name}_step(&controller, &setpoint, &measurement, &commands, &telemetry);
    }
    if (steps > 0)
        printf("%.0f ns per step (%ld steps, last command %.6g Pa), %u bytes of memory\n",
               1e9 * (double)(clock() - start) / CLOCKS_PER_SEC / (double)steps, steps, (double)commands.pressure1,
               (unsigned)sizeof controller);
    return wrong;
}
