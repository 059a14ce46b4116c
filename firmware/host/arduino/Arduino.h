/* As much of Arduino as the library uses, on the bench: an AVR core whose processor takes no time but for the bus. */
#ifndef ARDUINO_H
#define ARDUINO_H

#include <stddef.h>
#include <stdint.h>

enum { LOW, HIGH };
enum { INPUT, OUTPUT };
enum { SDA = 18, SCL = 19 };

void pinMode(uint8_t pin, uint8_t mode);
void digitalWrite(uint8_t pin, uint8_t value);
int digitalRead(uint8_t pin);
unsigned long micros();
void delayMicroseconds(unsigned microseconds);

struct Stream {
    int availableForWrite();
    size_t write(const uint8_t *data, size_t count);
    int read();
};

struct HardwareSerial : Stream {
    void begin(unsigned long baud);
};
extern HardwareSerial Serial;

void setup();
void loop();

#endif
