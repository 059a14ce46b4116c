/* The commands of the bench: lines on standard input, each answered by one line of JSON. */
#ifndef CONSOLE_H
#define CONSOLE_H

#include <stdbool.h>

/* What has come in and is no whole line yet. */
struct console {
    char line[1 << 16];
    unsigned count;
};

/* Reads what is there and obeys its commands; may block if nothing is. False at the end of the input. */
bool console_read(struct console *console);

#endif
