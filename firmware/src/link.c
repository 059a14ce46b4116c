#include "link.h"

#include <string.h>

#include "hal.h"
#include "identity.h"

enum { BYTES_PER_CALL = 32 }; /* endless input must not keep the measurements waiting */

void link_open(struct link *link, uint16_t boot)
{
    static const uint8_t END = 0;
    memset(link, 0, sizeof *link);
    link->boot = boot;
    link->identify = true;
    hal_uart_send(&END, 1);
}

static void receive(struct link *link)
{
    uint8_t byte;
    for (uint8_t i = 0; i < BYTES_PER_CALL && hal_uart_receive(&byte); i++) {
        struct request request;
        if (!receiver_take(&link->receiver, byte, &request)) {
            continue;
        }
        if (request.kind == KIND_IDENTIFY) {
            link->identify = true;
        } else if (link->pings_count < PINGS_WAITING) {
            link->pings[link->pings_count++] = request.sequence;
        }
    }
}

static void reply_to_oldest_ping(struct link *link)
{
    uint8_t frame[FRAME_MAX];
    const uint32_t sequence = link->pings[0];
    link->pings_count--;
    memmove(link->pings, link->pings + 1, link->pings_count * sizeof link->pings[0]);
    link->ranges_next = true;
    hal_uart_send(frame, ping_reply_frame(frame, link->boot, sequence, hal_micros()));
}

static void send_identity(struct link *link)
{
    uint8_t frame[FRAME_MAX];
    uint8_t serial[SERIAL_SIZE];
    link->identify = false;
    link->ranges_next = true;
    hal_serial(serial);
    hal_uart_send(frame, identity_frame(frame, link->boot, serial, PERIOD_US, FIRMWARE));
}

static void send_waiting_ranges(struct link *link)
{
    hal_uart_send(link->ranges, link->ranges_count);
    link->ranges_count = 0;
    link->ranges_next = false;
}

void link_serve(struct link *link)
{
    receive(link);
    if (!hal_uart_idle()) {
        return;
    }
    if (link->ranges_count != 0 && link->ranges_next) {
        send_waiting_ranges(link);
    } else if (link->pings_count != 0) {
        reply_to_oldest_ping(link);
    } else if (link->identify) {
        send_identity(link);
    } else if (link->ranges_count != 0) {
        send_waiting_ranges(link);
    }
}

void link_send_ranges(struct link *link, uint32_t sequence, uint32_t micros, const struct reading readings[MODULES])
{
    link->ranges_count = ranges_frame(link->ranges, link->boot, sequence, micros, readings);
}
