#include "console.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "bench.h"
#include "device.h"
#include "line.h"

static void answer_error(const char *what)
{
    printf("{\"error\": \"%s\"}\n", what);
}

static void answer_state(void)
{
    printf("{\"micros\": %" PRIu64 ", \"collisions\": %" PRIu32 ", \"modules\": [", device_now(), bench_bus.collisions);
    for (int k = 0; k < MODULES; k++) {
        const struct chip *chip = &bench_bus.chips[k];
        printf("%s{\"address\": %d, \"held\": %s, \"tuned\": %s, \"measurements\": %" PRIu32 ", \"mistakes\": %" PRIu32 "}",
               k == 0 ? "" : ", ", chip->address, chip->held ? "true" : "false",
               chip_is_tuned(chip) ? "true" : "false", chip->measurements, chip->mistakes);
    }
    printf("]}\n");
}

static void answer_run(const char *milliseconds)
{
    device_advance(device_now() + strtoul(milliseconds, NULL, 10) * 1000u);
    printf("{\"micros\": %" PRIu64 ", \"sent\": \"", device_now());
    uint8_t byte;
    while (line_take_sent(&byte)) {
        printf("%02x", byte);
    }
    printf("\"}\n");
}

static void answer_receive(const char *hex)
{
    unsigned byte;
    for (; sscanf(hex, "%2x", &byte) == 1; hex += 2) {
        const uint8_t value = (uint8_t)byte;
        line_give(&value, 1);
    }
    printf("{}\n");
}

/* Commands about one chip. False: there is no such command. */
static bool obey_for(struct chip *chip, const char *command, const long *numbers, int count)
{
    const uint64_t now = device_now();
    chip_settle(chip, now);
    if (strcmp(command, "see") == 0 && count == 2) {
        chip->range_mm = (uint8_t)numbers[0];
        chip->status = (uint8_t)numbers[1] & 0x0F;
    } else if (strcmp(command, "convergence") == 0 && count == 1) {
        chip->convergence_us = (uint32_t)numbers[0];
    } else if (strcmp(command, "slow") == 0 && count == 1) {
        chip->slow_percent = (int8_t)numbers[0];
    } else if (strcmp(command, "unplug") == 0 && count == 0) {
        chip->plugged = false;
    } else if (strcmp(command, "plug") == 0 && count == 0) {
        chip->plugged = true;
        chip_power_up(chip, now);
    } else if (strcmp(command, "brownout") == 0 && count == 0) {
        chip_power_up(chip, now);
    } else if (strcmp(command, "hang") == 0 && count == 0) {
        chip->hung = true;
    } else {
        return false;
    }
    printf("{}\n");
    return true;
}

static void obey(const char *line)
{
    char command[16] = "";
    long module = -1;
    long numbers[2] = {0, 0};
    const int words = sscanf(line, "%15s %ld %ld %ld", command, &module, &numbers[0], &numbers[1]);
    const char *rest = line + strcspn(line, " ");
    if (strcmp(command, "state") == 0) {
        answer_state();
    } else if (strcmp(command, "reboot") == 0) {
        device_reset();
        printf("{}\n");
    } else if (strcmp(command, "stick") == 0 && words == 2 && module >= 0) {
        bench_bus.stuck_clocks = (uint32_t)module;
        printf("{}\n");
    } else if (strcmp(command, "freeze") == 0 && device_freeze()) {
        printf("{}\n");
    } else if (strcmp(command, "run") == 0 && !line_has_port()) {
        answer_run(rest);
    } else if (strcmp(command, "receive") == 0 && !line_has_port()) {
        answer_receive(rest + strspn(rest, " "));
    } else if (words < 2 || module < 0 || module >= MODULES ||
               !obey_for(&bench_bus.chips[module], command, numbers, words - 2)) {
        answer_error("no such command: the README of the firmware lists them");
    }
}

bool console_read(struct console *console)
{
    const ssize_t count = read(STDIN_FILENO, console->line + console->count, sizeof console->line - 1 - console->count);
    if (count <= 0) {
        return false;
    }
    console->count += (unsigned)count;
    char *from = console->line;
    char *end;
    while ((end = memchr(from, '\n', console->count)) != NULL) {
        *end = '\0';
        obey(from);
        console->count -= (unsigned)(end + 1 - from);
        from = end + 1;
    }
    memmove(console->line, from, console->count);
    if (console->count == sizeof console->line - 1) {
        answer_error("longer than any command");
        console->count = 0;
    }
    return fflush(stdout) == 0;
}
