/* hal.h on top of Arduino. What differs from core to core stands in the first lines. */
#include "PretouchFinger.h"

#include <EEPROM.h>
#include <string.h>

extern "C" {
#include "hal.h"
}

namespace {

constexpr uint32_t BUS_HZ = 400000;
constexpr uint16_t WATCHDOG_MS = 250;
constexpr uint8_t BUS_TIMEOUT_MS = 2;
constexpr uint8_t RELEASE_CLOCKS = 9;
constexpr int MEMORY_SERIAL = 0, MEMORY_BOOT = SERIAL_SIZE, MEMORY_SIZE = SERIAL_SIZE + 2;

TwoWire *bus;
uint8_t sda, scl;
const uint8_t *reset_pins;
Stream *line;
int line_room; /* the most that there ever was: then nothing waits to be sent */

#if defined(ARDUINO_ARCH_ESP32)

/* Low, or let go. */
void pull_low(uint8_t pin, bool low)
{
    pinMode(pin, OUTPUT_OPEN_DRAIN);
    digitalWrite(pin, low ? LOW : HIGH);
}
void limit_bus_time() { bus->setTimeOut(BUS_TIMEOUT_MS); }
void start_watchdog() { enableLoopWDT(); } /* of 5 s; the core feeds it between two calls of loop() */
void feed_watchdog() {}
void open_memory() { EEPROM.begin(MEMORY_SIZE); }
void close_memory() { EEPROM.commit(); }
void chip_serial(uint8_t serial[SERIAL_SIZE])
{
    const uint64_t number = ESP.getEfuseMac();
    memcpy(serial, &number, SERIAL_SIZE);
}

#else

void pull_low(uint8_t pin, bool low)
{
    digitalWrite(pin, LOW);
    pinMode(pin, low ? OUTPUT : INPUT);
}

#if defined(ARDUINO_ARCH_RP2040)

} // namespace
#include <pico/unique_id.h>
namespace {

void limit_bus_time() { bus->setTimeout(BUS_TIMEOUT_MS, true); }
void start_watchdog() { rp2040.wdt_begin(WATCHDOG_MS); }
void feed_watchdog() { rp2040.wdt_reset(); }
void open_memory() { EEPROM.begin(256); }
void close_memory() { EEPROM.commit(); }
void chip_serial(uint8_t serial[SERIAL_SIZE])
{
    pico_unique_board_id_t number;
    pico_get_unique_board_id(&number);
    memcpy(serial, number.id, SERIAL_SIZE);
}

#else

} // namespace
#include <avr/wdt.h>
namespace {

void limit_bus_time() { bus->setWireTimeout(1000ul * BUS_TIMEOUT_MS, true); }
void start_watchdog() { wdt_enable(WDTO_250MS); }
void feed_watchdog() { wdt_reset(); }
void open_memory() {}
void close_memory() {}
void chip_serial(uint8_t serial[SERIAL_SIZE]) { memset(serial, 0, SERIAL_SIZE); }

#endif
#endif

void start_bus()
{
    bus->begin();
    bus->setClock(BUS_HZ);
    limit_bus_time();
}

/* Clocks out whatever a chip that was cut off in the middle of a byte still wants to say, and ends with a stop. */
void release_bus()
{
    bus->end();
    pull_low(sda, false);
    for (uint8_t i = 0; i < RELEASE_CLOCKS; i++) {
        pull_low(scl, true);
        delayMicroseconds(2);
        pull_low(scl, false);
        delayMicroseconds(2);
    }
    pull_low(sda, true);
    delayMicroseconds(2);
    pull_low(sda, false);
    start_bus();
}

bool ended(bool well)
{
    if (!well && digitalRead(sda) == LOW) { /* at rest it is high, also after an address that nobody answered */
        release_bus();
    }
    return well;
}

void select_register(uint8_t address, uint16_t index)
{
    bus->beginTransmission(address);
    bus->write(static_cast<uint8_t>(index >> 8));
    bus->write(static_cast<uint8_t>(index));
}

} // namespace

bool hal_i2c_write(uint8_t address, uint16_t index, const uint8_t *data, uint8_t count)
{
    select_register(address, index);
    bus->write(data, count);
    return ended(bus->endTransmission() == 0);
}

bool hal_i2c_read(uint8_t address, uint16_t index, uint8_t *data, uint8_t count)
{
    select_register(address, index);
    const bool well = bus->endTransmission(false) == 0 && bus->requestFrom(address, count) == count;
    for (uint8_t i = 0; i < count && well; i++) {
        data[i] = static_cast<uint8_t>(bus->read());
    }
    return ended(well);
}

void hal_hold_in_reset(uint8_t module, bool held)
{
    pull_low(reset_pins[module], held);
}

uint32_t hal_micros(void)
{
    return static_cast<uint32_t>(micros());
}

/* On USB there is room whenever the host has fetched everything; a host that fetches nothing delays nothing here. */
bool hal_uart_idle(void)
{
    const int room = line->availableForWrite();
    line_room = room > line_room ? room : line_room;
    return room > 0 && room == line_room;
}

void hal_uart_send(const uint8_t *data, uint8_t count)
{
    line->write(data, count);
}

bool hal_uart_receive(uint8_t *byte)
{
    const int value = line->read();
    *byte = static_cast<uint8_t>(value);
    return value >= 0;
}

uint16_t hal_next_boot(void)
{
    uint16_t boot;
    open_memory();
    EEPROM.get(MEMORY_BOOT, boot);
    boot++;
    EEPROM.put(MEMORY_BOOT, boot);
    close_memory();
    return boot;
}

void hal_serial(uint8_t serial[SERIAL_SIZE])
{
    bool written = false;
    for (uint8_t i = 0; i < SERIAL_SIZE; i++) {
        serial[i] = EEPROM.read(MEMORY_SERIAL + i);
        written = written || serial[i] != 0xFF;
    }
    if (!written) {
        chip_serial(serial);
    }
}

PretouchFinger::PretouchFinger(
    TwoWire &on_bus, uint8_t on_sda, uint8_t on_scl, const uint8_t (&on_reset_pins)[MODULES], Stream &on_line)
{
    bus = &on_bus;
    sda = on_sda;
    scl = on_scl;
    reset_pins = on_reset_pins;
    line = &on_line;
}

void PretouchFinger::begin()
{
    line_room = line->availableForWrite();
    start_bus();
    start_watchdog();
    finger_boot(&finger);
}

void PretouchFinger::step()
{
    feed_watchdog();
    finger_step(&finger);
}
