/* Consistent Overhead Byte Stuffing (Cheshire and Baker, 1999) of short data: one byte more, and no byte is zero. */
#ifndef COBS_H
#define COBS_H

#include <stdint.h>

/* Encodes at most 253 bytes; `encoded` holds count + 1. Returns count + 1. */
uint8_t cobs_encode(const uint8_t *data, uint8_t count, uint8_t *encoded);

/* Decodes in place. Returns the number of bytes, 0 if `frame` is no encoding of at least one byte. */
uint8_t cobs_decode(uint8_t *frame, uint8_t count);

#endif
