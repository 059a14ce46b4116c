#ifndef TWI_H
#define TWI_H

/* The two-wire interface as I2C master at 400 kHz. */
void twi_init(void);

#endif
