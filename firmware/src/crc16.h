#ifndef CRC16_H
#define CRC16_H

#include <stdint.h>

/* CRC-16/IBM-3740: polynomial 0x1021, start 0xFFFF, nothing reflected or inverted. "123456789" gives 0x29B1. */
uint16_t crc16(const uint8_t *data, uint8_t count);

#endif
