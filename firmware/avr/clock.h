#ifndef CLOCK_H
#define CLOCK_H

/* Starts timer 1, from which hal_micros counts. */
void clock_init(void);

#endif
