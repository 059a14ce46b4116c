#include "chip.h"

#include <string.h>

enum {
    MODEL_ID = 0x000,
    INTERRUPT_CONFIG = 0x014,
    INTERRUPT_CLEAR = 0x015,
    FRESH_OUT_OF_RESET = 0x016,
    RANGE_START = 0x018,
    MAX_CONVERGENCE_MS = 0x01C,
    VHV_RECALIBRATE = 0x02E,
    RANGE_STATUS = 0x04D,
    INTERRUPT_STATUS = 0x04F,
    RANGE_VAL = 0x062,
    AVERAGING_SAMPLES = 0x10A,
    DEVICE_ADDRESS = 0x212,
};

enum {
    BOOT_US = 1400,
    CALIBRATION_US = 3200,
    READOUT_US = 1300,
    DEVICE_READY = 0x01,
    NEW_SAMPLE = 0x04,
    INVALID_RANGE = 255,
    UNTUNED_RANGE = 14,
    LAST_SYSTEM_ERROR = 5,
};

/* The tuned value of every private register, in the order of their addresses. */
static const uint16_t TUNED[][2] = {
    {0x030, 0x00}, {0x096, 0x00}, {0x097, 0xFD}, {0x09F, 0x00}, {0x0A3, 0x3C}, {0x0B2, 0x09}, {0x0B7, 0x00}, {0x0BB, 0x3C},
    {0x0CA, 0x09}, {0x0D9, 0x05}, {0x0DB, 0xCE}, {0x0DC, 0x03}, {0x0DD, 0xF8}, {0x0E3, 0x00}, {0x0E4, 0x04}, {0x0E5, 0x02},
    {0x0E6, 0x01}, {0x0E7, 0x03}, {0x0F5, 0x02}, {0x0FF, 0x05}, {0x100, 0x05}, {0x198, 0x01}, {0x199, 0x05}, {0x1A6, 0x1B},
    {0x1A7, 0x1F}, {0x1AC, 0x3E}, {0x1AD, 0x00}, {0x1B0, 0x17}, {0x207, 0x01}, {0x208, 0x01},
};
enum { TUNED_COUNT = sizeof TUNED / sizeof TUNED[0] };

static bool is_private(uint16_t index)
{
    for (int i = 0; i < TUNED_COUNT; i++) {
        if (TUNED[i][0] == index) {
            return true;
        }
    }
    return false;
}

static bool is_public_setting(uint16_t index)
{
    return index == INTERRUPT_CONFIG || index == FRESH_OUT_OF_RESET || index == MAX_CONVERGENCE_MS ||
           index == VHV_RECALIBRATE || index == 0x031 || index == AVERAGING_SAMPLES || index == DEVICE_ADDRESS;
}

void chip_power_up(struct chip *chip, uint64_t now_us)
{
    memset(chip->registers, 0, sizeof chip->registers);
    for (int i = 0; i < TUNED_COUNT; i++) {
        chip->registers[TUNED[i][0]] = 0xA5; /* anything but the tuned value, none of which is that */
    }
    chip->registers[MODEL_ID] = 0xB4;
    chip->registers[FRESH_OUT_OF_RESET] = 1;
    chip->registers[MAX_CONVERGENCE_MS] = 49;
    chip->registers[RANGE_STATUS] = DEVICE_READY;
    chip->registers[AVERAGING_SAMPLES] = 48;
    chip->registers[DEVICE_ADDRESS] = CHIP_DEFAULT_ADDRESS;
    chip->address = CHIP_DEFAULT_ADDRESS;
    chip->measuring = false;
    chip->hung = false;
    chip->booted_us = now_us + BOOT_US;
}

void chip_hold(struct chip *chip, bool held, uint64_t now_us)
{
    if (chip->held && !held) {
        chip_power_up(chip, now_us);
    }
    chip->held = held;
}

bool chip_answers(const struct chip *chip, uint8_t address, uint64_t now_us)
{
    return chip->plugged && !chip->held && now_us >= chip->booted_us && chip->address == address;
}

bool chip_is_tuned(const struct chip *chip)
{
    for (int i = 0; i < TUNED_COUNT; i++) {
        if (chip->registers[TUNED[i][0]] != TUNED[i][1]) {
            return false;
        }
    }
    return true;
}

static void start(struct chip *chip, uint8_t value, uint64_t now_us)
{
    if (chip->measuring) { /* only a reset helps after that */
        chip->mistakes++;
        chip->hung = true;
        return;
    }
    if (value != 1 || !chip_is_tuned(chip) || chip->registers[FRESH_OUT_OF_RESET] != 0) {
        chip->mistakes++;
    }
    const uint64_t longest_us = chip->registers[MAX_CONVERGENCE_MS] * 1000u;
    const uint64_t convergence_us = chip->convergence_us < longest_us ? chip->convergence_us : longest_us;
    const uint64_t readout_us = READOUT_US + chip->registers[AVERAGING_SAMPLES] * 645u / 10u;
    const uint64_t nominal_us = CALIBRATION_US + convergence_us + readout_us;
    chip->measuring = true;
    chip->done_us = now_us + nominal_us * (uint64_t)(100 + chip->slow_percent) / 100u;
    chip->registers[RANGE_STATUS] = 0; /* not ready for another start */
}

void chip_settle(struct chip *chip, uint64_t now_us)
{
    if (!chip->measuring || now_us < chip->done_us) {
        return;
    }
    const uint8_t status = (uint8_t)(chip->status << 4);
    if (chip->status != 0 && chip->status <= LAST_SYSTEM_ERROR && !chip->hung) {
        chip->registers[RANGE_STATUS] = status; /* as users saw: the code is there, the interrupt never comes */
        chip->hung = true;
    }
    if (chip->hung) {
        return;
    }
    chip->measuring = false;
    chip->measurements++;
    chip->registers[RANGE_STATUS] = (uint8_t)(status | DEVICE_READY);
    const uint8_t range = chip_is_tuned(chip) ? chip->range_mm : UNTUNED_RANGE;
    chip->registers[RANGE_VAL] = chip->status == 0 ? range : INVALID_RANGE;
    if ((chip->registers[INTERRUPT_CONFIG] & 0x07) == NEW_SAMPLE) {
        chip->registers[INTERRUPT_STATUS] = NEW_SAMPLE;
    }
}

void chip_write(struct chip *chip, uint8_t value, uint64_t now_us)
{
    chip_settle(chip, now_us);
    const uint16_t index = chip->index++ % CHIP_REGISTERS;
    if (index == INTERRUPT_CLEAR) {
        chip->registers[INTERRUPT_STATUS] = (value & 0x01) ? 0 : chip->registers[INTERRUPT_STATUS];
    } else if (index == RANGE_START) {
        start(chip, value, now_us);
    } else {
        if (chip->measuring || !(is_private(index) || is_public_setting(index))) {
            chip->mistakes++;
        }
        chip->registers[index] = value;
        chip->address = chip->registers[DEVICE_ADDRESS] & 0x7F;
    }
}

uint8_t chip_read(struct chip *chip, uint64_t now_us)
{
    chip_settle(chip, now_us);
    return chip->registers[chip->index++ % CHIP_REGISTERS];
}
