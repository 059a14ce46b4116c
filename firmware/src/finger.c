#include "finger.h"

#include <string.h>

#include "hal.h"
#include "identity.h"
#include "vl6180x.h"

void finger_boot(struct finger *finger)
{
    memset(finger, 0, sizeof *finger);
    finger->awakening = MODULES;
    finger->next_module = MODULES;
    finger->untried = (1u << MODULES) - 1;
    for (uint8_t k = 0; k < MODULES; k++) {
        module_hold(&finger->modules[k], k, hal_micros());
    }
    link_open(&finger->link, hal_next_boot());
}

static void bring_up(struct finger *finger, uint32_t now)
{
    if (finger->awakening < MODULES) {
        if (!module_bring_up(&finger->modules[finger->awakening], now)) {
            finger->untried &= (uint8_t)~(1u << finger->awakening);
            finger->awakening = MODULES;
        }
    } else {
        for (uint8_t k = 0; k < MODULES; k++) {
            if (module_waits(&finger->modules[k], now)) {
                module_let_go(&finger->modules[k], now);
                finger->awakening = k;
                break;
            }
        }
    }
    if (!finger->ticking && finger->untried == 0) {
        finger->ticking = true;
        finger->next_tick = now;
    }
}

static bool tick_is_due(const struct finger *finger, uint32_t now)
{
    return finger->ticking && (int32_t)(now - finger->next_tick) >= 0;
}

static void begin_tick(struct finger *finger, uint32_t now)
{
    finger->next_tick += PERIOD_US;
    if (tick_is_due(finger, now)) { /* held up for more than a period */
        finger->next_tick = now + PERIOD_US;
    }
    finger->next_module = 0;
}

static void end_tick(struct finger *finger, uint32_t now)
{
    if (finger->measured) {
        link_send_ranges(&finger->link, finger->sequence++, finger->middle, finger->readings);
    }
    finger->middle = finger->first_start + (now - finger->first_start) / 2 + VL6180X_MIDDLE_US;
    finger->measured = true;
}

static void measure_next(struct finger *finger)
{
    const uint8_t k = finger->next_module++;
    finger->readings[k] = module_measure(&finger->modules[k], hal_micros());
    if (k == 0) {
        finger->first_start = hal_micros();
    }
    if (finger->next_module == MODULES) {
        end_tick(finger, hal_micros());
    }
}

void finger_step(struct finger *finger)
{
    link_serve(&finger->link);
    const uint32_t now = hal_micros();
    if (finger->next_module < MODULES) {
        measure_next(finger);
    } else if (tick_is_due(finger, now)) {
        begin_tick(finger, now);
    } else {
        bring_up(finger, now);
    }
}
