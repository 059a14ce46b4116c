#include "module.h"

#include "hal.h"
#include "vl6180x.h"

enum {
    FIRST_ADDRESS = 0x30,
    HOLD_US = 1000,
    BOOT_US = 1000,
    BOOT_LOOKS = 10,
    FAILURES_MAX = 3,
};
#define RETRY_US 1000000ul

static uint8_t address_of(const struct module *module)
{
    return (uint8_t)(FIRST_ADDRESS + module->index);
}

static bool reached(uint32_t now, uint32_t moment)
{
    return (int32_t)(now - moment) >= 0;
}

static void hold_until(struct module *module, uint32_t due)
{
    hal_hold_in_reset(module->index, true);
    module->state = MODULE_HELD;
    module->due = due;
}

void module_hold(struct module *module, uint8_t index, uint32_t now)
{
    module->index = index;
    hold_until(module, now + HOLD_US);
}

bool module_waits(const struct module *module, uint32_t now)
{
    return module->state == MODULE_HELD && reached(now, module->due);
}

void module_let_go(struct module *module, uint32_t now)
{
    hal_hold_in_reset(module->index, false);
    module->state = MODULE_BOOTING;
    module->step = 0;
    module->failures = 0;
    module->due = now + BOOT_US;
}

/* False: it did not boot. */
static bool boot(struct module *module, uint32_t now)
{
    if (!reached(now, module->due)) {
        return true;
    }
    if (!vl6180x_fresh(VL6180X_DEFAULT_ADDRESS)) {
        module->due = now + BOOT_US;
        return ++module->step < BOOT_LOOKS;
    }
    module->state = MODULE_CONFIGURING;
    module->step = 0;
    return vl6180x_change_address(VL6180X_DEFAULT_ADDRESS, address_of(module));
}

/* False: it stopped answering. */
static bool configure(struct module *module)
{
    if (!vl6180x_set(address_of(module), module->step)) {
        return false;
    }
    if (++module->step == vl6180x_settings()) {
        module->state = MODULE_READY;
    }
    return true;
}

bool module_bring_up(struct module *module, uint32_t now)
{
    const bool well = module->state == MODULE_BOOTING ? boot(module, now) : configure(module);
    if (!well) {
        hold_until(module, now + RETRY_US);
    }
    return module->state == MODULE_BOOTING || module->state == MODULE_CONFIGURING;
}

/* False: the module must not be started. */
static bool take(struct module *module, struct reading *reading, uint32_t now)
{
    const enum vl6180x_result result = vl6180x_take(address_of(module), reading);
    if (result == VL6180X_MEASURED && !vl6180x_failed(reading->status)) {
        module->failures = 0;
        return true;
    }
    if (result == VL6180X_ABSENT || ++module->failures == FAILURES_MAX) {
        module_hold(module, module->index, now);
    }
    return result == VL6180X_MEASURED && module->state == MODULE_MEASURING;
}

struct reading module_measure(struct module *module, uint32_t now)
{
    struct reading reading = {NO_RANGE, STATUS_NO_ANSWER};
    const bool startable = module->state == MODULE_READY ||
                           (module->state == MODULE_MEASURING && take(module, &reading, now));
    if (startable) {
        module->state = MODULE_MEASURING;
        if (!vl6180x_start(address_of(module))) {
            module_hold(module, module->index, now);
        }
    }
    return reading;
}
