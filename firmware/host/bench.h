/* The surroundings of the board: chips on its bus, and the far end of its serial line. */
#ifndef BENCH_H
#define BENCH_H

#include <stdbool.h>
#include <stdint.h>

#include "bus.h"

extern struct bus bench_bus;

/* The board has sent a byte. */
void bench_sent(uint8_t byte);

/* The next byte that arrives at the board, if one is on its way; to be asked once a byte's time on the line. */
bool bench_arrives(uint8_t *byte);

/* 115200 baud, 8N1. */
enum { BENCH_BYTE_NS = 86806 };

#endif
