#include "crc16.h"

/* Remainders of the sixteen 4-bit values: 32 bytes, four times as fast as bit by bit. */
static const uint16_t REMAINDERS[16] = {
    0x0000, 0x1021, 0x2042, 0x3063, 0x4084, 0x50A5, 0x60C6, 0x70E7,
    0x8108, 0x9129, 0xA14A, 0xB16B, 0xC18C, 0xD1AD, 0xE1CE, 0xF1EF,
};

static uint16_t with_nibble(uint16_t crc, uint8_t nibble)
{
    return (uint16_t)((uint16_t)(crc << 4) ^ REMAINDERS[(crc >> 12) ^ nibble]);
}

uint16_t crc16(const uint8_t *data, uint8_t count)
{
    uint16_t crc = 0xFFFF;
    for (uint8_t i = 0; i < count; i++) {
        crc = with_nibble(crc, data[i] >> 4);
        crc = with_nibble(crc, data[i] & 0x0F);
    }
    return crc;
}
