/* Finds the host's requests in whatever bytes come in. Its memory is bounded and no input does it harm. */
#ifndef RECEIVER_H
#define RECEIVER_H

#include <stdbool.h>
#include <stdint.h>

#include "messages.h"

enum { REQUEST_FRAME = HEADER_SIZE + CRC_SIZE + 1 }; /* both requests are a bare header */

struct receiver {
    uint8_t frame[REQUEST_FRAME];
    uint8_t count; /* REQUEST_FRAME + 1: too long, waits for the zero */
};

struct request {
    enum kind kind; /* KIND_PING or KIND_IDENTIFY */
    uint32_t sequence;
};

/* Takes one byte. True when it completes a request; anything else is ignored. */
bool receiver_take(struct receiver *receiver, uint8_t byte, struct request *request);

#endif
