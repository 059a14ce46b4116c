/* What the firmware needs of a board. One file each under avr/ (the hardware) and host/ (a bench) provides it.
 *
 * Nothing here blocks for longer than one bus transaction, and a bus that hangs ends a transaction with false.
 */
#ifndef HAL_H
#define HAL_H

#include <stdbool.h>
#include <stdint.h>

enum { MODULES = 6 };

/* Writes or reads registers from `index` (16 bits, high byte first) of the chip at the 7-bit address. False: no answer. */
bool hal_i2c_write(uint8_t address, uint16_t index, const uint8_t *data, uint8_t count);
bool hal_i2c_read(uint8_t address, uint16_t index, uint8_t *data, uint8_t count);

/* Pulls a module's GPIO0 low, or lets go of it. */
void hal_hold_in_reset(uint8_t module, bool held);

/* Microseconds since any moment; wraps at 2^32. */
uint32_t hal_micros(void);

/* True when the last stop bit of all that was sent is out. Only then may the next be sent; it is copied. */
bool hal_uart_idle(void);
#define UART_SEND_MAX 64
void hal_uart_send(const uint8_t *data, uint8_t count);
bool hal_uart_receive(uint8_t *byte);

/* Counts in memory that survives power-off, at every call. */
uint16_t hal_next_boot(void);

enum { SERIAL_SIZE = 8 };
/* Unique to the board; all zero if it has none. */
void hal_serial(uint8_t serial[SERIAL_SIZE]);

#endif
