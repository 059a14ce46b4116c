/* The VL6180X: its registers, the settings it needs after a reset, and one measurement at a time.
 *
 * Register names and meanings: ST datasheet DocID026171; settings: ST application note AN4545, section 9.
 * Every function is one to four bus transactions and returns false (or VL6180X_ABSENT) when one was not answered.
 */
#ifndef VL6180X_H
#define VL6180X_H

#include <stdbool.h>
#include <stdint.h>

#include "messages.h"

enum { VL6180X_DEFAULT_ADDRESS = 0x29 };

/* Longest convergence allowed. A whole measurement then takes at most 3.2 ms (calibration) + 18 ms + 4.4 ms (readout)
 * = 25.6 ms, and 28.2 ms by an oscillator 10 % slow: always done within a period of 30 ms. The datasheet's slowest
 * target, 3 % reflective at 100 mm, converges in 10.7 ms. */
enum { VL6180X_CONVERGENCE_MS = 18 };

/* From the start of a measurement to the middle of the time that its light is gathered: 3.2 ms of calibration, then
 * half of a typical convergence of 2 ms. */
enum { VL6180X_MIDDLE_US = 4200 };

/* Whether a VL6180X answers at the address, booted and with no setting made since its reset. */
bool vl6180x_fresh(uint8_t address);

bool vl6180x_change_address(uint8_t address, uint8_t new_address);

/* A fresh chip ranges properly only after all settings, from 0 to vl6180x_settings() - 1. */
uint8_t vl6180x_settings(void);
bool vl6180x_set(uint8_t address, uint8_t setting);

bool vl6180x_start(uint8_t address);

enum vl6180x_result { VL6180X_ABSENT, VL6180X_BUSY, VL6180X_MEASURED };
/* Takes the result of the measurement started last. `reading` is written when it is measured, and when the chip is
 * busy for ever after a failure of its own (status 1 to 5). */
enum vl6180x_result vl6180x_take(uint8_t address, struct reading *reading);

/* Status 1 to 5: the chip failed; it needs a reset. */
bool vl6180x_failed(uint8_t status);

#endif
