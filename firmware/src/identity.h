/* What the finger says of itself. */
#ifndef IDENTITY_H
#define IDENTITY_H

#define FIRMWARE "pretouch finger 1.0"

/* Microseconds between two measurements. */
#define PERIOD_US 30000ul

#endif
