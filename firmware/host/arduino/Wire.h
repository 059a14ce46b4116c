/* Arduino's I2C bus, with the bench's chips on it. */
#ifndef WIRE_H
#define WIRE_H

#include <stddef.h>
#include <stdint.h>

class TwoWire {
public:
    void begin();
    void end();
    void setClock(uint32_t hertz);
    void setWireTimeout(uint32_t microseconds, bool reset);
    void beginTransmission(uint8_t address);
    size_t write(uint8_t value);
    size_t write(const uint8_t *data, size_t count);
    uint8_t endTransmission(bool stop = true);
    uint8_t requestFrom(uint8_t address, uint8_t count);
    int read();

private:
    uint8_t address;
    uint8_t buffer[32]; /* as large as that of an AVR core */
    uint8_t filled;
    uint8_t taken;
};
extern TwoWire Wire;

#endif
