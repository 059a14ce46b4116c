/* Six chips on one I2C bus, byte by byte as a master sees them. Two that have the same address answer together. */
#ifndef BUS_H
#define BUS_H

#include <stdbool.h>
#include <stdint.h>

#include "chip.h"
#include "hal.h"

struct bus {
    struct chip chips[MODULES];
    uint8_t selected;     /* bit k: chip k answered to the address */
    uint8_t index_bytes;  /* of the two that a write begins with */
    uint32_t stuck_clocks; /* SDA is held low until SCL has been clocked so often */
    uint32_t collisions;  /* times that more than one chip answered */
};

void bus_power_up(struct bus *bus, uint64_t now_us);

/* After a start or repeated start: whether any chip acknowledges. */
bool bus_address(struct bus *bus, uint8_t address, bool reading, uint64_t now_us);
void bus_write(struct bus *bus, uint8_t value, uint64_t now_us);
/* SCL was clocked while nobody drove SDA. */
void bus_clock(struct bus *bus);
uint8_t bus_read(struct bus *bus, uint64_t now_us);

#endif
