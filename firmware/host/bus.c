#include "bus.h"

void bus_power_up(struct bus *bus, uint64_t now_us)
{
    for (int k = 0; k < MODULES; k++) {
        bus->chips[k].plugged = true;
        bus->chips[k].range_mm = 100;
        bus->chips[k].convergence_us = 1200;
        chip_power_up(&bus->chips[k], now_us);
    }
}

bool bus_address(struct bus *bus, uint8_t address, bool reading, uint64_t now_us)
{
    bus->selected = 0;
    if (bus->stuck_clocks != 0) {
        return false;
    }
    for (int k = 0; k < MODULES; k++) {
        if (chip_answers(&bus->chips[k], address, now_us)) {
            bus->collisions += bus->selected != 0;
            bus->selected |= (uint8_t)(1u << k);
        }
    }
    bus->index_bytes = reading ? 2 : 0;
    return bus->selected != 0;
}

void bus_write(struct bus *bus, uint8_t value, uint64_t now_us)
{
    for (int k = 0; k < MODULES; k++) {
        struct chip *chip = &bus->chips[k];
        if (!(bus->selected >> k & 1)) {
            continue;
        }
        if (bus->index_bytes < 2) {
            chip->index = (uint16_t)(chip->index << 8 | value);
        } else {
            chip_write(chip, value, now_us);
        }
    }
    if (bus->index_bytes < 2) {
        bus->index_bytes++;
    }
}

void bus_clock(struct bus *bus)
{
    bus->stuck_clocks -= bus->stuck_clocks != 0;
}

uint8_t bus_read(struct bus *bus, uint64_t now_us)
{
    uint8_t value = 0xFF; /* nobody pulls a line down */
    for (int k = 0; k < MODULES; k++) {
        if (bus->selected >> k & 1) {
            value &= chip_read(&bus->chips[k], now_us);
        }
    }
    return value;
}
