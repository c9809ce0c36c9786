/* The board is this computer: its serial line is standard input and output, its joint is simulated.
 *     ./firmware            in real time
 *     ./firmware lockstep   a period after each frame from the host
 */
#define _POSIX_C_SOURCE 200809L
#include "firmware.h"
#include "simulated.h"

#include <poll.h>
#include <stdio.h>
#include <time.h>
#include <unistd.h>

void board_write(const uint8_t *bytes, size_t size)
{
    fwrite(bytes, 1, size, stdout);
    fflush(stdout);
}

/* Bytes that are there; until the end of a frame, if that is to be waited for. False at the end of the input. */
static bool receive(bool wait)
{
    struct pollfd input = {STDIN_FILENO, POLLIN, 0};
    uint8_t byte = 1;
    while (poll(&input, 1, wait ? -1 : 0) > 0) {
        if (read(STDIN_FILENO, &byte, 1) != 1)
            return false;
        firmware_receive(byte);
        if (wait && !byte)
            return true;
    }
    return true;
}

int main(int count, char **arguments)
{
    const bool lockstep = count > 1 && arguments[1][0] == 'l';
    struct timespec next, now;
    simulated_begin();
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
