/* Arduino's EEPROM, as delivered. */
#ifndef EEPROM_H
#define EEPROM_H

#include <stdint.h>
#include <string.h>

struct EEPROMClass {
    uint8_t bytes[64];

    EEPROMClass() { memset(bytes, 0xFF, sizeof bytes); }
    uint8_t read(int at) { return bytes[at]; }
    template <typename T> void get(int at, T &value) { memcpy(&value, bytes + at, sizeof value); }
    template <typename T> void put(int at, const T &value) { memcpy(bytes + at, &value, sizeof value); }
};
extern EEPROMClass EEPROM;

#endif
