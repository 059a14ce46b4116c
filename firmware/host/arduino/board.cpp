/* The sketch of the Arduino library as the bench's device. */
#include <Arduino.h>
#include <EEPROM.h>
#include <Wire.h>

extern "C" {
#include "bench.h"
#include "device.h"
}

namespace {

constexpr uint64_t STEP_NS = 20000, BUS_BYTE_NS = 22500, BUS_CONDITIONS_NS = 5000, TIMEOUT_NS = 2000000;
constexpr uint32_t CLOCK_START_US = UINT32_MAX - 2000000u; /* it wraps two seconds after power-up */
constexpr uint8_t PINS = 20, FIRST_RESET_PIN = 2;
constexpr int SEND_BUFFER = 63;

uint64_t now_ns, byte_in_ns, byte_out_ns;
uint8_t modes[PINS], levels[PINS];
uint8_t sending[SEND_BUFFER];
int sending_count, sent_count;

void start_to_send()
{
    sent_count = 0;
    sending_count = 0;
}

bool addressed(uint8_t address, bool reading)
{
    if (bench_bus.stuck_clocks != 0) {
        now_ns += TIMEOUT_NS;
        return false;
    }
    now_ns += BUS_CONDITIONS_NS + BUS_BYTE_NS;
    return bus_address(&bench_bus, address, reading, device_now());
}

void set_pin(uint8_t pin)
{
    const bool low = modes[pin] == OUTPUT && levels[pin] == LOW;
    if (pin >= FIRST_RESET_PIN && pin < FIRST_RESET_PIN + MODULES) {
        chip_hold(&bench_bus.chips[pin - FIRST_RESET_PIN], low, device_now());
    }
}

} // namespace

HardwareSerial Serial;
TwoWire Wire;
EEPROMClass EEPROM;

uint64_t device_now(void)
{
    return now_ns / 1000;
}

const char *device_power_up(const char *elf)
{
    if (elf != nullptr) {
        return "the sketch is compiled in: leave the file out";
    }
    setup();
    return nullptr;
}

void device_reset(void)
{
    start_to_send();
    for (uint8_t pin = 0; pin < PINS; pin++) {
        modes[pin] = INPUT;
        set_pin(pin);
    }
    setup();
}

bool device_freeze(void)
{
    return false;
}

void device_advance(uint64_t until_us)
{
    while (device_now() < until_us) {
        loop();
        now_ns += STEP_NS;
        while (sent_count < sending_count && byte_out_ns <= now_ns) {
            bench_sent(sending[sent_count++]);
            byte_out_ns += BENCH_BYTE_NS;
        }
    }
}

void pinMode(uint8_t pin, uint8_t mode)
{
    const bool was_low = modes[pin] == OUTPUT && levels[pin] == LOW;
    modes[pin] = mode;
    set_pin(pin);
    if (pin == SCL && was_low && mode == INPUT) {
        bus_clock(&bench_bus);
    }
}

void digitalWrite(uint8_t pin, uint8_t value)
{
    levels[pin] = value;
    set_pin(pin);
}

int digitalRead(uint8_t pin)
{
    return pin == SDA && bench_bus.stuck_clocks != 0 ? LOW : HIGH;
}

unsigned long micros()
{
    return static_cast<uint32_t>(CLOCK_START_US + device_now());
}

void delayMicroseconds(unsigned microseconds)
{
    now_ns += 1000ull * microseconds;
}

void HardwareSerial::begin(unsigned long)
{
}

int Stream::availableForWrite()
{
    return SEND_BUFFER - (sending_count - sent_count) - (now_ns < byte_out_ns ? 1 : 0);
}

size_t Stream::write(const uint8_t *data, size_t count)
{
    start_to_send(); /* it is only called when all was sent */
    memcpy(sending, data, count);
    sending_count = static_cast<int>(count);
    byte_out_ns = now_ns + BENCH_BYTE_NS;
    return count;
}

int Stream::read()
{
    uint8_t byte;
    if (now_ns < byte_in_ns || !bench_arrives(&byte)) {
        return -1;
    }
    byte_in_ns = now_ns + BENCH_BYTE_NS;
    return byte;
}

void TwoWire::begin()
{
}

void TwoWire::end()
{
}

void TwoWire::setClock(uint32_t)
{
}

void TwoWire::setWireTimeout(uint32_t, bool)
{
}

void TwoWire::beginTransmission(uint8_t to)
{
    address = to;
    filled = 0;
}

size_t TwoWire::write(uint8_t value)
{
    return write(&value, 1);
}

size_t TwoWire::write(const uint8_t *data, size_t count)
{
    memcpy(buffer + filled, data, count);
    filled = static_cast<uint8_t>(filled + count);
    return count;
}

uint8_t TwoWire::endTransmission(bool)
{
    if (!addressed(address, false)) {
        return 2;
    }
    for (uint8_t i = 0; i < filled; i++) {
        now_ns += BUS_BYTE_NS;
        bus_write(&bench_bus, buffer[i], device_now());
    }
    return 0;
}

uint8_t TwoWire::requestFrom(uint8_t from, uint8_t count)
{
    taken = 0;
    if (!addressed(from, true)) {
        return 0;
    }
    for (uint8_t i = 0; i < count; i++) {
        now_ns += BUS_BYTE_NS;
        buffer[i] = bus_read(&bench_bus, device_now());
    }
    return count;
}

int TwoWire::read()
{
    return buffer[taken++];
}
