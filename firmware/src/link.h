/* The serial line: answers pings and identifies, and sends measurements between them. */
#ifndef LINK_H
#define LINK_H

#include <stdbool.h>
#include <stdint.h>

#include "messages.h"
#include "receiver.h"

enum { PINGS_WAITING = 4 }; /* the host sends eight in 0.4 s, and a reply waits at most 3 ms for a frame of ranges */

struct link {
    uint16_t boot;
    struct receiver receiver;
    uint32_t pings[PINGS_WAITING]; /* oldest first */
    uint8_t pings_count;
    bool identify;
    bool ranges_next; /* a reply was sent last: replies alone must not fill the line */
    uint8_t ranges[RANGES_SIZE + FRAME_OVERHEAD];
    uint8_t ranges_count; /* 0: none waits */
};

/* Ends with a zero whatever a boot loader said, and tells who is there. */
void link_open(struct link *link, uint16_t boot);

/* Takes what has come in and sends what is most urgent once the line is idle. */
void link_serve(struct link *link);

/* Has a measurement sent; it replaces one that is still waiting. */
void link_send_ranges(struct link *link, uint32_t sequence, uint32_t micros, const struct reading readings[MODULES]);

#endif
