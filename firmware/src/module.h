/* One of the modules on the bus: from its reset line to its readings, and back to reset when it no longer answers. */
#ifndef MODULE_H
#define MODULE_H

#include <stdbool.h>
#include <stdint.h>

#include "messages.h"

enum module_state {
    MODULE_HELD,        /* in reset, its bus pins off the bus */
    MODULE_BOOTING,     /* let go, at the default address: never two modules at a time */
    MODULE_CONFIGURING, /* at its own address, settings under way */
    MODULE_READY,       /* configured, no measurement started */
    MODULE_MEASURING,
};

struct module {
    uint8_t index;
    enum module_state state;
    uint8_t step;     /* booting: looks so far; configuring: the next setting */
    uint8_t failures; /* measurements in a row that did not end well */
    uint32_t due;     /* held: not let go before; booting: not looked at before */
};

/* Holds the module in reset for at least the shortest time that it notices. */
void module_hold(struct module *module, uint8_t index, uint32_t now);

/* Whether it is held and may be let go. */
bool module_waits(const struct module *module, uint32_t now);
void module_let_go(struct module *module, uint32_t now);

/* Goes one bus transaction or two further. False when it is through: MODULE_READY, or MODULE_HELD for a second. */
bool module_bring_up(struct module *module, uint32_t now);

/* Takes the measurement started at the last call and starts the next. STATUS_NO_ANSWER if there is none. */
struct reading module_measure(struct module *module, uint32_t now);

#endif
