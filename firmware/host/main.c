/* Runs the firmware on a bench.
 *
 *     finger-host             behind a pseudo-terminal, in real time; prints {"port": PATH}
 *     finger-host --console   in simulated time: the commands `run` and `receive` take the serial line's place
 *
 * The simulated AVR takes its machine code as the last argument. Ends when standard input does.
 */
#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "bench.h"
#include "console.h"
#include "device.h"
#include "line.h"

enum { PIECE_US = 5000 };

struct bus bench_bus;

static uint64_t real_us(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u;
}

/* On a machine that is too slow for the simulated AVR, the board's time falls behind, but it goes on talking. */
static void keep_pace(struct console *console)
{
    const uint64_t start_us = real_us();
    bool open = true;
    while (open) {
        if (line_exchange()) {
            open = console_read(console);
        }
        const uint64_t now_us = real_us() - start_us;
        const uint64_t enough_us = device_now() + PIECE_US;
        device_advance(now_us < enough_us ? now_us : enough_us);
    }
}

int main(int argc, char **argv)
{
    static struct console console;
    const bool by_console = argc > 1 && strcmp(argv[1], "--console") == 0;
    const int files = argc - 1 - by_console;
    if (files > 1) {
        fprintf(stderr, "usage: %s [--console] [ELF]\n", argv[0]);
        return 2;
    }
    const char *path = by_console ? NULL : line_open_port();
    if (!by_console && path == NULL) {
        fprintf(stderr, "no pseudo-terminal: %s\n", strerror(errno));
        return 1;
    }
    bus_power_up(&bench_bus, 0);
    const char *trouble = device_power_up(files == 1 ? argv[argc - 1] : NULL);
    if (trouble != NULL) {
        fprintf(stderr, "%s\n", trouble);
        return 1;
    }
    if (by_console) {
        while (console_read(&console)) {
        }
    } else {
        printf("{\"port\": \"%s\"}\n", path);
        fflush(stdout);
        keep_pace(&console);
    }
    return 0;
}
