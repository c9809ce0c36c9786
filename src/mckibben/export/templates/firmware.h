/* Firmware of "${title}", written by mckibben ${version}: a controller that a host arms on a serial line (link.h). */
#ifndef FIRMWARE_H
#define FIRMWARE_H

#include "link.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { MEASUREMENTS = ${measurements | length}, COMMANDS = ${air | length}, SETPOINTS = ${setpoints | length}, PERIOD_US = ${microseconds}, SILENCE_US = ${silence} };

/* At the start; `watchdog` says that the watchdog reset the board. */
void firmware_begin(bool watchdog);

/* Each byte from the host. */
void firmware_receive(uint8_t byte);

/* Once in each period, outside of interrupts; `missed` periods have passed without a call. */
void firmware_step(uint16_t missed);

/* Of the board, called by the functions above. */
uint32_t board_time(void); /* us, modulo 2^32 */
void board_measure(double values[MEASUREMENTS]); /* ${measurements | join(", ")}, in SI */
void board_command(const double commands[COMMANDS]); /* Pa, gauge */
void board_vent(bool open); /* the valve between regulators and atmosphere */
void board_write(const uint8_t *bytes, size_t size);

#ifdef __cplusplus
}
#endif

#endif
