/* The firmware as the bench runs it: natively (host/native.c) or as the AVR's own machine code (simavr/avr_device.c).
 *
 * Its time is the bench's, in microseconds from 0, and passes only in device_advance.
 */
#ifndef DEVICE_H
#define DEVICE_H

#include <stdbool.h>
#include <stdint.h>

/* Powers the board up. `elf`: the machine code, NULL for the native build. Returns an error in words, or NULL. */
const char *device_power_up(const char *elf);

/* Resets the board, as its reset button does; its EEPROM and the chips stay as they are. */
void device_reset(void);

/* The processor hangs, as after a spike on its supply. False: this build has none that could. */
bool device_freeze(void);

void device_advance(uint64_t until_us);
uint64_t device_now(void);

#endif
