#include "cobs.h"

uint8_t cobs_encode(const uint8_t *data, uint8_t count, uint8_t *encoded)
{
    uint8_t code = 0; /* where the present block's code byte stands */
    uint8_t end = 1;
    for (uint8_t i = 0; i < count; i++) {
        if (data[i] != 0) {
            encoded[end++] = data[i];
        } else {
            encoded[code] = (uint8_t)(end - code);
            code = end++;
        }
    }
    encoded[code] = (uint8_t)(end - code);
    return end;
}

uint8_t cobs_decode(uint8_t *frame, uint8_t count)
{
    uint8_t from = 0;
    uint8_t to = 0;
    while (from < count) {
        const uint8_t code = frame[from];
        if (code == 0 || code > count - from) {
            return 0;
        }
        const uint8_t next = (uint8_t)(from + code);
        while (++from < next) {
            frame[to++] = frame[from];
        }
        if (from < count) {
            frame[to++] = 0;
        }
    }
    return to;
}
