#include "twi.h"

#include <util/delay.h>
#include <util/twi.h>

#include "hal.h"
#include "pins.h"

enum {
    BUS_HZ_DIVIDER = 12, /* 16 MHz / (16 + 2 x 12) = 400 kHz */
    WAIT_LOOPS = 2000,   /* at least a millisecond: forty times a byte's time, so any stretching of the clock fits */
    RELEASE_CLOCKS = 9,
};

void twi_init(void)
{
    TWBR = BUS_HZ_DIVIDER;
    TWSR = 0;
    TWCR = _BV(TWEN);
}

/* Clocks out whatever a chip that was cut off in the middle of a byte still wants to say, and ends with a stop. */
static void release_bus(void)
{
    TWCR = 0;
    BUS_PORT &= (uint8_t)~(SDA | SCL);
    for (uint8_t i = 0; i < RELEASE_CLOCKS; i++) {
        BUS_DDR |= SCL;
        _delay_us(2);
        BUS_DDR &= (uint8_t)~SCL;
        _delay_us(2);
    }
    BUS_DDR |= SDA;
    _delay_us(2);
    BUS_DDR &= (uint8_t)~SDA;
    twi_init();
}

static bool wait_while(uint8_t bit, uint8_t value)
{
    for (uint16_t i = 0; i < WAIT_LOOPS; i++) {
        if ((TWCR & bit) != value) {
            return true;
        }
    }
    release_bus();
    return false;
}

/* Has the interface do one step, and returns the status that it ends with: TW_BUS_ERROR if it does not end. */
static uint8_t step(uint8_t control)
{
    TWCR = (uint8_t)(_BV(TWINT) | _BV(TWEN) | control);
    return wait_while(_BV(TWINT), 0) ? TWSR & TW_STATUS_MASK : TW_BUS_ERROR;
}

static bool start(void)
{
    const uint8_t status = step(_BV(TWSTA));
    return status == TW_START || status == TW_REP_START;
}

/* Sends an address or a data byte. True if it was acknowledged. */
static bool put(uint8_t byte)
{
    TWDR = byte;
    const uint8_t status = step(0);
    return status == TW_MT_SLA_ACK || status == TW_MT_DATA_ACK || status == TW_MR_SLA_ACK;
}

static bool get(uint8_t *byte, bool last)
{
    const uint8_t status = step(last ? 0 : _BV(TWEA));
    *byte = TWDR;
    return status == (last ? TW_MR_DATA_NACK : TW_MR_DATA_ACK);
}

static bool stop(bool well)
{
    TWCR = _BV(TWINT) | _BV(TWEN) | _BV(TWSTO);
    return wait_while(_BV(TWSTO), _BV(TWSTO)) && well;
}

static bool select_register(uint8_t address, uint16_t index)
{
    return start() && put((uint8_t)(address << 1 | TW_WRITE)) && put((uint8_t)(index >> 8)) && put((uint8_t)index);
}

bool hal_i2c_write(uint8_t address, uint16_t index, const uint8_t *data, uint8_t count)
{
    bool well = select_register(address, index);
    for (uint8_t i = 0; i < count && well; i++) {
        well = put(data[i]);
    }
    return stop(well);
}

bool hal_i2c_read(uint8_t address, uint16_t index, uint8_t *data, uint8_t count)
{
    bool well = select_register(address, index) && start() && put((uint8_t)(address << 1 | TW_READ));
    for (uint8_t i = 0; i < count && well; i++) {
        well = get(&data[i], i + 1 == count);
    }
    return stop(well);
}
