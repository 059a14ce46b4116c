/* The fingertip: measures with all modules once a period and sends every measurement.
 *
 * All modules are started by this clock, one after the other within 3 ms, and read and started again at the next tick.
 * Modules in their own continuous mode would each keep the time of their own oscillator, some percent off: within
 * seconds they would measure at six different moments, and no single time could be told for them.
 */
#ifndef FINGER_H
#define FINGER_H

#include <stdbool.h>
#include <stdint.h>

#include "link.h"
#include "module.h"

struct finger {
    struct link link;
    struct module modules[MODULES];
    uint8_t awakening; /* the module being brought up; MODULES: none */
    uint8_t untried;   /* bit k: module k was not yet brought up or given up; no ticks before */
    bool ticking;
    uint32_t next_tick;
    uint8_t next_module; /* to be measured in this tick; MODULES: all are */
    bool measured;       /* a measurement was started at the tick before */
    uint32_t sequence;
    uint32_t first_start;
    uint32_t middle; /* of the measurement under way */
    struct reading readings[MODULES];
};

void finger_boot(struct finger *finger);

/* Does one piece of work, at most half a millisecond long. To be called without end. */
void finger_step(struct finger *finger);

#endif
