/* The serial line between the board and whoever talks to it: a pseudo-terminal, or the console. */
#ifndef LINE_H
#define LINE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Opens a pseudo-terminal and returns its path; NULL with errno set when there is none. Without it the line is the
 * console's. */
const char *line_open_port(void);
bool line_has_port(void);

/* Passes on what the board has sent, and takes in what was written to the port; waits for that or for standard input,
 * a millisecond at most. Nobody at the port: what the board sends is lost, as on any serial line. True when standard
 * input can be read. */
bool line_exchange(void);

/* The console's end: bytes on their way to the board, and bytes that it has sent. */
void line_give(const uint8_t *data, size_t count);
bool line_take_sent(uint8_t *byte);

#endif
