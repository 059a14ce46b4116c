/* The firmware as an Arduino library: for AVR boards, for RP2040 and RP2350 (the core of earlephilhower), and for ESP32. */
#ifndef PRETOUCH_FINGER_H
#define PRETOUCH_FINGER_H

#include <Arduino.h>
#include <Wire.h>

extern "C" {
#include "finger.h"
}

/* The only finger of a board. */
class PretouchFinger {
public:
    /* All six modules on `bus`, whose pins are `sda` and `scl`; the GPIO0 of module k on reset_pins[k]; the host on `line`. */
    PretouchFinger(TwoWire &bus, uint8_t sda, uint8_t scl, const uint8_t (&reset_pins)[MODULES], Stream &line);

    /* Starts the bus, the watchdog and the finger. Call it in setup(), after the line's own begin(). */
    void begin();

    /* Does one piece of work, at most some milliseconds long. Call it in loop(), and nothing that takes long beside it. */
    void step();

private:
    struct finger finger;
};

#endif
