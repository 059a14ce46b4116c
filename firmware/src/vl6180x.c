#include "vl6180x.h"

#include "hal.h"

enum {
    IDENTIFICATION__MODEL_ID = 0x000,
    SYSTEM__INTERRUPT_CONFIG_GPIO = 0x014,
    SYSTEM__INTERRUPT_CLEAR = 0x015,
    SYSTEM__FRESH_OUT_OF_RESET = 0x016,
    SYSRANGE__START = 0x018,
    SYSRANGE__MAX_CONVERGENCE_TIME = 0x01C,
    SYSRANGE__VHV_RECALIBRATE = 0x02E,
    SYSRANGE__VHV_REPEAT_RATE = 0x031,
    RESULT__RANGE_STATUS = 0x04D, /* followed by the ALS status and RESULT__INTERRUPT_STATUS_GPIO */
    RESULT__RANGE_VAL = 0x062,
    READOUT__AVERAGING_SAMPLE_PERIOD = 0x10A,
    I2C_SLAVE__DEVICE_ADDRESS = 0x212,
};

enum {
    MODEL_ID = 0xB4,
    NEW_SAMPLE_READY = 0x04,
    INTERRUPT_OF_RANGE = 0x07,
    CLEAR_ALL = 0x07,
    START_SINGLE_SHOT = 0x01,
    NO_ERROR = 0,
    LAST_SYSTEM_ERROR = 5,
    TENTHS_PER_MM = 10,
};

struct setting {
    uint16_t index;
    uint8_t value;
};

static const struct setting SETTINGS[] = {
    /* AN4545, "Mandatory: private registers": ST names none of them */
    {0x207, 0x01}, {0x208, 0x01}, {0x096, 0x00}, {0x097, 0xFD}, {0x0E3, 0x00}, {0x0E4, 0x04},
    {0x0E5, 0x02}, {0x0E6, 0x01}, {0x0E7, 0x03}, {0x0F5, 0x02}, {0x0D9, 0x05}, {0x0DB, 0xCE},
    {0x0DC, 0x03}, {0x0DD, 0xF8}, {0x09F, 0x00}, {0x0A3, 0x3C}, {0x0B7, 0x00}, {0x0BB, 0x3C},
    {0x0B2, 0x09}, {0x0CA, 0x09}, {0x198, 0x01}, {0x1B0, 0x17}, {0x1AD, 0x00}, {0x0FF, 0x05},
    {0x100, 0x05}, {0x199, 0x05}, {0x1A6, 0x1B}, {0x1AC, 0x3E}, {0x1A7, 0x1F}, {0x030, 0x00},
    /* AN4545, "Recommended: public registers", as far as they concern ranging */
    {READOUT__AVERAGING_SAMPLE_PERIOD, 48}, /* 1.3 ms + 48 x 64.5 us of readout */
    {SYSRANGE__VHV_REPEAT_RATE, 255},       /* calibrates itself anew every 255 measurements */
    {SYSRANGE__VHV_RECALIBRATE, 1},
    {SYSTEM__INTERRUPT_CONFIG_GPIO, NEW_SAMPLE_READY},
    {SYSRANGE__MAX_CONVERGENCE_TIME, VL6180X_CONVERGENCE_MS},
    {SYSTEM__FRESH_OUT_OF_RESET, 0},
};

static bool write1(uint8_t address, uint16_t index, uint8_t value)
{
    return hal_i2c_write(address, index, &value, 1);
}

bool vl6180x_fresh(uint8_t address)
{
    uint8_t model;
    uint8_t fresh;
    return hal_i2c_read(address, IDENTIFICATION__MODEL_ID, &model, 1) &&
           hal_i2c_read(address, SYSTEM__FRESH_OUT_OF_RESET, &fresh, 1) && model == MODEL_ID && fresh == 1;
}

bool vl6180x_change_address(uint8_t address, uint8_t new_address)
{
    return write1(address, I2C_SLAVE__DEVICE_ADDRESS, new_address);
}

uint8_t vl6180x_settings(void)
{
    return sizeof SETTINGS / sizeof SETTINGS[0];
}

bool vl6180x_set(uint8_t address, uint8_t setting)
{
    return write1(address, SETTINGS[setting].index, SETTINGS[setting].value);
}

bool vl6180x_start(uint8_t address)
{
    return write1(address, SYSRANGE__START, START_SINGLE_SHOT);
}

enum vl6180x_result vl6180x_take(uint8_t address, struct reading *reading)
{
    uint8_t results[3];
    if (!hal_i2c_read(address, RESULT__RANGE_STATUS, results, sizeof results)) {
        return VL6180X_ABSENT;
    }
    const uint8_t status = results[0] >> 4;
    if ((results[2] & INTERRUPT_OF_RANGE) != NEW_SAMPLE_READY) {
        if (vl6180x_failed(status)) {
            *reading = (struct reading){NO_RANGE, status};
        }
        return VL6180X_BUSY;
    }
    uint8_t millimetres;
    if (!hal_i2c_read(address, RESULT__RANGE_VAL, &millimetres, 1) ||
        !write1(address, SYSTEM__INTERRUPT_CLEAR, CLEAR_ALL)) {
        return VL6180X_ABSENT;
    }
    reading->range = status == STATUS_GOOD ? (uint16_t)(millimetres * TENTHS_PER_MM) : NO_RANGE;
    reading->status = status;
    return VL6180X_MEASURED;
}

bool vl6180x_failed(uint8_t status)
{
    return status != NO_ERROR && status <= LAST_SYSTEM_ERROR;
}
