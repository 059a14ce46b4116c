/* The reset lines, and what the EEPROM remembers. */
#include <avr/eeprom.h>

#include "hal.h"
#include "pins.h"

#define EEPROM_SERIAL ((const void *)0) /* eight bytes; as delivered, all 0xFF: no serial number */
#define EEPROM_BOOT ((uint16_t *)SERIAL_SIZE)

/* Open drain: low or let go, never driven high, because the module's side has 2.8 V. */
void hal_hold_in_reset(uint8_t module, bool held)
{
    const uint8_t pin = (uint8_t)(RESET_FIRST << module);
    RESET_PORT &= (uint8_t)~pin;
    RESET_DDR = held ? RESET_DDR | pin : RESET_DDR & (uint8_t)~pin;
}

uint16_t hal_next_boot(void)
{
    const uint16_t boot = (uint16_t)(eeprom_read_word(EEPROM_BOOT) + 1);
    eeprom_update_word(EEPROM_BOOT, boot);
    return boot;
}

void hal_serial(uint8_t serial[SERIAL_SIZE])
{
    uint8_t ones = 0xFF;
    eeprom_read_block(serial, EEPROM_SERIAL, SERIAL_SIZE);
    for (uint8_t i = 0; i < SERIAL_SIZE; i++) {
        ones &= serial[i];
    }
    for (uint8_t i = 0; ones == 0xFF && i < SERIAL_SIZE; i++) {
        serial[i] = 0;
    }
}
