/* A register model of the VL6180X: what the firmware can tell of one, and what it must not do to one.
 *
 * Written from the datasheet (DocID026171), AN4545 and users' reports, on its own account: it shares no table with the
 * firmware. What a real chip is known to do when it is treated wrongly it does too, and counts it in `mistakes`.
 */
#ifndef CHIP_H
#define CHIP_H

#include <stdbool.h>
#include <stdint.h>

enum { CHIP_REGISTERS = 0x300, CHIP_DEFAULT_ADDRESS = 0x29 };

struct chip {
    bool plugged;
    bool held;                /* GPIO0 is low */
    bool hung;                /* ends no measurement until the next reset */
    uint8_t range_mm;         /* what it is to measure */
    uint8_t status;           /* and the status code it is to give */
    uint32_t convergence_us;  /* how long that takes */
    int8_t slow_percent;      /* its oscillator's error */
    uint8_t address;
    uint16_t index;           /* register of the next byte on the bus */
    uint8_t registers[CHIP_REGISTERS];
    uint64_t booted_us;
    bool measuring;
    uint64_t done_us;
    uint32_t measurements;
    uint32_t mistakes;        /* untuned or fresh when started, started or set up while it measured, unknown registers */
};

void chip_power_up(struct chip *chip, uint64_t now_us);
void chip_hold(struct chip *chip, bool held, uint64_t now_us);

/* Lets time pass: ends a measurement whose time is up. */
void chip_settle(struct chip *chip, uint64_t now_us);

bool chip_answers(const struct chip *chip, uint8_t address, uint64_t now_us);
bool chip_is_tuned(const struct chip *chip);

/* One data byte at `index`, which moves on. */
void chip_write(struct chip *chip, uint8_t value, uint64_t now_us);
uint8_t chip_read(struct chip *chip, uint64_t now_us);

#endif
