/* The firmware on QEMU's mps2-an500: Cortex-M7 with a simulated joint; the serial line is its first UART.
 * Periods are due by the interrupt of the system timer, and wait for the end of a frame from the host.
 */
#include "firmware.h"
#include "simulated.h"

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define DATA REGISTER(0x40004000)
#define STATE REGISTER(0x40004004) /* 1: cannot send, 2: received */

extern uint8_t __bss_start__, __bss_end__;
extern void __libc_init_array(void);
static volatile uint32_t ticks;
static void tick(void) { ++ticks; }
static void hang(void)
{
    for (;;)
        continue;
}

void board_write(const uint8_t *bytes, size_t size)
{
    while (size-- > 0) {
        while (STATE & 1)
            continue;
        DATA = *bytes++;
    }
}

int main(void)
{
    uint32_t seen = 0;
    REGISTER(0x40004010) = 16; /* rate */
    REGISTER(0x40004008) = 3;  /* send and receive */
    REGISTER(0xE000E014) = 25000 - 1; /* system timer: 1 ms at 25 MHz */
    REGISTER(0xE000E018) = 0;
    REGISTER(0xE000E010) = 7;
    simulated_begin(0, 0);
    firmware_begin(false);
    for (;;) {
        uint8_t byte = 1;
        while (byte)
            if (STATE & 2)
                firmware_receive(byte = (uint8_t)DATA);
        while (seen == ticks)
            continue;
        seen = ticks;
        firmware_step(0);
        simulated_advance();
    }
}

static void reset(void)
{
    REGISTER(0xE000ED88) |= 0xFu << 20; /* floating-point unit */
    __asm volatile("dsb\n isb");
    main();
}

__attribute__((section(".vectors"), used)) static void (*const vectors[16])(void) = {
    (void (*)(void))0x20400000, reset, hang, hang, hang, hang, hang, 0, 0, 0, 0, hang, hang, 0, hang, tick};
