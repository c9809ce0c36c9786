/* The board is this computer, its joints are simulated.
<% if weight %>
 *     ./firmware PORT [MASS DISTANCE]   in real time, with a serial port of this name, which is made; a weight [kg] is
 *                                       clipped on the limb, at a distance [m] from the axis
<% else %>
 *     ./firmware PORT                   in real time, with a serial port of this name, which is made
<% endif %>
 *     ./firmware                        a period after each frame from the host, on standard input and output
 */
#define _XOPEN_SOURCE 700
#define _DEFAULT_SOURCE
#define _DARWIN_C_SOURCE
#include "firmware.h"
#include "simulated.h"

#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

static int input = STDIN_FILENO, output = STDOUT_FILENO;

void board_write(const uint8_t *bytes, size_t size)
{
    while (size > 0) {
        const ssize_t written = write(output, bytes, size);
        if (written < 0)
            exit(1);
        bytes += written;
        size -= (size_t)written;
    }
}

/* A pseudo-terminal in place of the serial line, with a name. */
static bool open_port(const char *name)
{
    struct termios raw;
    int host;
    input = output = posix_openpt(O_RDWR | O_NOCTTY);
    if (input < 0 || grantpt(input) != 0 || unlockpt(input) != 0)
        return false;
    host = open(ptsname(input), O_RDWR | O_NOCTTY); /* stays open, as hosts come and go */
    if (host < 0 || tcgetattr(host, &raw) != 0)
        return false;
    cfmakeraw(&raw);
    unlink(name);
    return tcsetattr(host, TCSANOW, &raw) == 0 && symlink(ptsname(input), name) == 0;
}

/* Bytes that are there; until the end of a frame, if that is to be waited for. False at the end of the input. */
static bool receive(bool wait)
{
    struct pollfd ready = {input, POLLIN, 0};
    uint8_t byte = 1;
    while (poll(&ready, 1, wait ? -1 : 0) > 0) {
        if (read(input, &byte, 1) != 1)
            return false;
        firmware_receive(byte);
        if (wait && !byte)
            return true;
    }
    return true;
}

int main(int count, char **arguments)
{
    const bool lockstep = count < 2;
    struct timespec next, now;
    if (!lockstep && !open_port(arguments[1])) {
        perror(arguments[1]);
        return 1;
    }
<% if weight %>
    simulated_begin(count > 3 ? atof(arguments[2]) : 0, count > 3 ? atof(arguments[3]) : 0);
<% else %>
    simulated_begin();
<% endif %>
    firmware_begin(false);
    clock_gettime(CLOCK_MONOTONIC, &next);
    while (receive(lockstep)) {
        firmware_step(0);
        simulated_advance();
        next.tv_nsec += PERIOD_US * 1000L;
        for (; next.tv_nsec >= 1000000000L; next.tv_nsec -= 1000000000L)
            ++next.tv_sec;
        if (lockstep)
            continue;
        clock_gettime(CLOCK_MONOTONIC, &now);
        if (now.tv_sec > next.tv_sec + 1) /* nobody has read the line: do not catch up */
            next = now;
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &next, NULL);
    }
    return 0;
}
