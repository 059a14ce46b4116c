#include "messages.h"

#include <string.h>

#include "cobs.h"
#include "crc16.h"

static uint8_t *put16(uint8_t *at, uint16_t value)
{
    *at++ = (uint8_t)value;
    *at++ = (uint8_t)(value >> 8);
    return at;
}

static uint8_t *put32(uint8_t *at, uint32_t value)
{
    return put16(put16(at, (uint16_t)value), (uint16_t)(value >> 16));
}

static uint8_t *put_header(uint8_t *at, enum kind kind, uint16_t boot, uint32_t sequence, uint32_t micros)
{
    *at++ = FORMAT_VERSION;
    *at++ = (uint8_t)kind;
    at = put16(at, boot);
    at = put32(at, sequence);
    return put32(at, micros);
}

/* Adds the checksum behind `message` (which has room for it) and writes all of it as a frame. */
static uint8_t framed(uint8_t *frame, uint8_t *message, const uint8_t *end)
{
    const uint8_t count = (uint8_t)(end - message);
    put16(message + count, crc16(message, count));
    const uint8_t encoded = cobs_encode(message, (uint8_t)(count + CRC_SIZE), frame);
    frame[encoded] = 0;
    return (uint8_t)(encoded + 1);
}

uint8_t ranges_frame(uint8_t *frame, uint16_t boot, uint32_t sequence, uint32_t micros,
                     const struct reading readings[MODULES])
{
    uint8_t message[RANGES_SIZE + CRC_SIZE];
    uint8_t *at = put_header(message, KIND_RANGES, boot, sequence, micros);
    *at++ = MODULES;
    for (uint8_t k = 0; k < MODULES; k++) {
        at = put16(at, readings[k].range);
        *at++ = readings[k].status;
    }
    return framed(frame, message, at);
}

uint8_t ping_reply_frame(uint8_t *frame, uint16_t boot, uint32_t sequence, uint32_t micros)
{
    uint8_t message[HEADER_SIZE + CRC_SIZE];
    return framed(frame, message, put_header(message, KIND_PING_REPLY, boot, sequence, micros));
}

uint8_t identity_frame(uint8_t *frame, uint16_t boot, const uint8_t serial[SERIAL_SIZE], uint32_t period_us,
                       const char *firmware)
{
    uint8_t message[IDENTITY_MAX + CRC_SIZE];
    uint8_t *at = put_header(message, KIND_IDENTITY, boot, 0, 0);
    memcpy(at, serial, SERIAL_SIZE);
    at += SERIAL_SIZE;
    *at++ = MODULES;
    at = put32(at, period_us);
    for (uint8_t i = 0; i < FIRMWARE_MAX && firmware[i] != '\0'; i++) {
        *at++ = (uint8_t)firmware[i];
    }
    return framed(frame, message, at);
}
