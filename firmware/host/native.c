/* The firmware compiled for this machine: a board whose processor takes no time but for what is waited for. */
#include <string.h>

#include "bench.h"
#include "device.h"
#include "finger.h"
#include "hal.h"

enum {
    STEP_NS = 20000,
    BUS_BYTE_NS = 22500, /* nine bits at 400 kHz */
    BUS_CONDITIONS_NS = 5000,
    GIVE_UP_NS = 1000000,
    RELEASE_CLOCKS = 9,
};
#define CLOCK_START_US (UINT32_MAX - 2000000u) /* it wraps two seconds after power-up, so that every user sees it */

static struct finger finger;
static uint64_t now_ns;
static uint16_t eeprom_boot;
static uint8_t sending[UART_SEND_MAX];
static uint8_t sending_count;
static uint8_t sent_count;
static uint64_t byte_out_ns;
static uint64_t byte_in_ns;

uint64_t device_now(void)
{
    return now_ns / 1000;
}

const char *device_power_up(const char *elf)
{
    if (elf != NULL) {
        return "the native build runs no machine code: leave the file out";
    }
    finger_boot(&finger);
    return NULL;
}

void device_reset(void)
{
    sending_count = 0;
    sent_count = 0;
    for (uint8_t k = 0; k < MODULES; k++) {
        hal_hold_in_reset(k, false); /* the pins of a processor in reset pull nothing */
    }
    finger_boot(&finger);
}

bool device_freeze(void)
{
    return false;
}

void device_advance(uint64_t until_us)
{
    while (device_now() < until_us) {
        finger_step(&finger);
        now_ns += STEP_NS;
        while (sent_count < sending_count && byte_out_ns <= now_ns) {
            bench_sent(sending[sent_count++]);
            byte_out_ns += sent_count < sending_count ? BENCH_BYTE_NS : 0;
        }
    }
}

/* Gives up after a millisecond, and clocks the bus, as the boards do. */
static void release_bus(void)
{
    now_ns += GIVE_UP_NS;
    for (int i = 0; i < RELEASE_CLOCKS; i++) {
        bus_clock(&bench_bus);
    }
}

static bool addressed(uint8_t address, bool reading)
{
    if (bench_bus.stuck_clocks != 0) {
        release_bus();
        return false;
    }
    now_ns += BUS_CONDITIONS_NS + BUS_BYTE_NS;
    return bus_address(&bench_bus, address, reading, device_now());
}

static void put(uint8_t value)
{
    now_ns += BUS_BYTE_NS;
    bus_write(&bench_bus, value, device_now());
}

static bool select_register(uint8_t address, uint16_t index)
{
    if (!addressed(address, false)) {
        return false;
    }
    put((uint8_t)(index >> 8));
    put((uint8_t)index);
    return true;
}

bool hal_i2c_write(uint8_t address, uint16_t index, const uint8_t *data, uint8_t count)
{
    if (!select_register(address, index)) {
        return false;
    }
    for (uint8_t i = 0; i < count; i++) {
        put(data[i]);
    }
    return true;
}

bool hal_i2c_read(uint8_t address, uint16_t index, uint8_t *data, uint8_t count)
{
    if (!select_register(address, index) || !addressed(address, true)) {
        return false;
    }
    for (uint8_t i = 0; i < count; i++) {
        now_ns += BUS_BYTE_NS;
        data[i] = bus_read(&bench_bus, device_now());
    }
    return true;
}

void hal_hold_in_reset(uint8_t module, bool held)
{
    chip_hold(&bench_bus.chips[module], held, device_now());
}

uint32_t hal_micros(void)
{
    return (uint32_t)(CLOCK_START_US + device_now());
}

bool hal_uart_idle(void)
{
    return sent_count == sending_count && now_ns >= byte_out_ns;
}

void hal_uart_send(const uint8_t *data, uint8_t count)
{
    memcpy(sending, data, count);
    sending_count = count;
    sent_count = 0;
    byte_out_ns = now_ns + BENCH_BYTE_NS;
}

bool hal_uart_receive(uint8_t *byte)
{
    if (now_ns < byte_in_ns || !bench_arrives(byte)) {
        return false;
    }
    byte_in_ns = now_ns + BENCH_BYTE_NS;
    return true;
}

uint16_t hal_next_boot(void)
{
    return ++eeprom_boot;
}

void hal_serial(uint8_t serial[SERIAL_SIZE])
{
    static const uint8_t SERIAL[SERIAL_SIZE] = {'n', 'a', 't', 'i', 'v', 'e', 0, 1};
    memcpy(serial, SERIAL, SERIAL_SIZE);
}
