/* The firmware's encoders and its receiver, to be compared with another implementation: a line in, a line out.
 *
 *     ranges BOOT SEQUENCE MICROS RANGE STATUS ... (six pairs)     the frame in hexadecimal
 *     ping_reply BOOT SEQUENCE MICROS                              the frame
 *     identity BOOT SERIAL PERIOD FIRMWARE...                      the frame; SERIAL: 16 hexadecimal digits
 *     crc HEX                                                      the checksum, decimal
 *     receive HEX                                                  the requests found: `ping N` or `identify`, by commas
 *
 * One receiver takes the bytes of all `receive` lines.
 */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "crc16.h"
#include "messages.h"
#include "receiver.h"

static uint8_t bytes[1 << 15];

static size_t from_hex(const char *hex)
{
    size_t count = 0;
    unsigned byte;
    for (; count < sizeof bytes && sscanf(hex, "%2x", &byte) == 1; hex += 2) {
        bytes[count++] = (uint8_t)byte;
    }
    return count;
}

static void print_frame(const uint8_t *frame, uint8_t count)
{
    for (uint8_t i = 0; i < count; i++) {
        printf("%02x", frame[i]);
    }
}

static void print_ranges(char *words)
{
    uint32_t numbers[3 + 2 * MODULES];
    for (int i = 0; i < 3 + 2 * MODULES; i++) {
        numbers[i] = (uint32_t)strtoul(words, &words, 10);
    }
    struct reading readings[MODULES];
    for (int k = 0; k < MODULES; k++) {
        readings[k] = (struct reading){(uint16_t)numbers[3 + 2 * k], (uint8_t)numbers[4 + 2 * k]};
    }
    uint8_t frame[FRAME_MAX];
    print_frame(frame, ranges_frame(frame, (uint16_t)numbers[0], numbers[1], numbers[2], readings));
}

static void print_ping_reply(char *words)
{
    const uint16_t boot = (uint16_t)strtoul(words, &words, 10);
    const uint32_t sequence = (uint32_t)strtoul(words, &words, 10);
    uint8_t frame[FRAME_MAX];
    print_frame(frame, ping_reply_frame(frame, boot, sequence, (uint32_t)strtoul(words, NULL, 10)));
}

static void print_identity(char *words)
{
    const uint16_t boot = (uint16_t)strtoul(words, &words, 10);
    from_hex(words + 1);
    words += 1 + 2 * SERIAL_SIZE;
    const uint32_t period = (uint32_t)strtoul(words, &words, 10);
    uint8_t frame[FRAME_MAX];
    print_frame(frame, identity_frame(frame, boot, bytes, period, words + 1));
}

static void print_requests(const char *hex)
{
    static struct receiver receiver;
    const char *separator = "";
    const size_t count = from_hex(hex);
    for (size_t i = 0; i < count; i++) {
        struct request request;
        if (!receiver_take(&receiver, bytes[i], &request)) {
            continue;
        }
        if (request.kind == KIND_PING) {
            printf("%sping %" PRIu32, separator, request.sequence);
        } else {
            printf("%sidentify", separator);
        }
        separator = ",";
    }
}

int main(void)
{
    static char line[1 << 16];
    while (fgets(line, sizeof line, stdin) != NULL) {
        line[strcspn(line, "\n")] = '\0';
        char *words = line + strcspn(line, " ");
        if (strncmp(line, "ranges ", 7) == 0) {
            print_ranges(words);
        } else if (strncmp(line, "ping_reply ", 11) == 0) {
            print_ping_reply(words);
        } else if (strncmp(line, "identity ", 9) == 0) {
            print_identity(words);
        } else if (strncmp(line, "crc ", 4) == 0) {
            printf("%u", crc16(bytes, (uint8_t)from_hex(words + 1)));
        } else if (strncmp(line, "receive ", 8) == 0) {
            print_requests(words + 1);
        }
        printf("\n");
        fflush(stdout);
    }
    return 0;
}
