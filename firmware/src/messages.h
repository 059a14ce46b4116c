/* The messages of the binary format, version 1, and their frames: docs/reference/wire-formats.md describes both. */
#ifndef MESSAGES_H
#define MESSAGES_H

#include <assert.h>
#include <stdint.h>

#include "hal.h"

enum { FORMAT_VERSION = 1 };

enum kind {
    KIND_RANGES = 0x01,
    KIND_PING_REPLY = 0x02,
    KIND_IDENTITY = 0x03,
    KIND_PING = 0x81,
    KIND_IDENTIFY = 0x83,
};

enum { STATUS_GOOD = 0, STATUS_NO_ANSWER = 255 };
#define NO_RANGE 0xFFFFu

/* One module's share of a measurement: 0.1 mm along the beam or NO_RANGE, and its status code. */
struct reading {
    uint16_t range;
    uint8_t status;
};

enum {
    HEADER_SIZE = 12,
    FIRMWARE_MAX = 32,
    CRC_SIZE = 2,
    RANGES_SIZE = HEADER_SIZE + 1 + 3 * MODULES,
    IDENTITY_MAX = HEADER_SIZE + SERIAL_SIZE + 1 + 4 + FIRMWARE_MAX,
    MESSAGE_MAX = IDENTITY_MAX,
    FRAME_OVERHEAD = CRC_SIZE + 2, /* the code byte of COBS and the zero that ends it */
    FRAME_MAX = MESSAGE_MAX + FRAME_OVERHEAD,
};
static_assert(RANGES_SIZE <= MESSAGE_MAX, "ranges are not the longest message");
static_assert(FRAME_MAX <= UART_SEND_MAX, "the longest frame is sent in one piece");

/* Each writes a frame of at most FRAME_MAX bytes with the zero that ends it, and returns its length. */
uint8_t ranges_frame(uint8_t *frame, uint16_t boot, uint32_t sequence, uint32_t micros,
                     const struct reading readings[MODULES]);
uint8_t ping_reply_frame(uint8_t *frame, uint16_t boot, uint32_t sequence, uint32_t micros);
uint8_t identity_frame(uint8_t *frame, uint16_t boot, const uint8_t serial[SERIAL_SIZE], uint32_t period_us,
                       const char *firmware);

#endif
