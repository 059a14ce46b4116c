#include "uart.h"

#include <avr/interrupt.h>
#include <string.h>
#include <util/atomic.h>

#include "hal.h"
#include "pins.h"

enum {
    BAUD_DIVIDER = 16,    /* 16 MHz / (8 x (16 + 1)) = 117,647 baud: 2.1 % fast, as every 16 MHz Arduino at 115200 */
    RECEIVED_SIZE = 64,   /* a power of two; 5.5 ms of line */
};

static uint8_t sending[UART_SEND_MAX];
static volatile uint8_t sending_count;
static volatile uint8_t sent_count;
static uint8_t received[RECEIVED_SIZE];
static volatile uint8_t received_in;
static volatile uint8_t received_out;

void uart_init(void)
{
    UART_A = UART_DOUBLE_SPEED;
    UART_C = UART_8_BITS;
    UART_BAUD = BAUD_DIVIDER;
    UART_B = UART_RECEIVE | UART_SEND;
}

ISR(UART_RX_vect)
{
    const uint8_t byte = UART_DATA;
    const uint8_t next = (received_in + 1) & (RECEIVED_SIZE - 1);
    if (next != received_out) { /* else lost: the checksum of its frame will tell */
        received[received_in] = byte;
        received_in = next;
    }
}

ISR(UART_EMPTY_vect)
{
    UART_DATA = sending[sent_count++];
    UART_A = UART_DOUBLE_SPEED | UART_SENT; /* clears "transmission complete" */
    if (sent_count == sending_count) {
        UART_B &= (uint8_t)~UART_EMPTY_INTERRUPT;
    }
}

bool hal_uart_idle(void)
{
    return sending_count == 0 || (sent_count == sending_count && (UART_A & UART_SENT));
}

void hal_uart_send(const uint8_t *data, uint8_t count)
{
    memcpy(sending, data, count);
    sending_count = count;
    sent_count = 0;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) /* also keeps the compiler from filling the buffer later */
    {
        UART_B |= UART_EMPTY_INTERRUPT;
    }
}

bool hal_uart_receive(uint8_t *byte)
{
    if (received_out == received_in) {
        return false;
    }
    *byte = received[received_out];
    received_out = (received_out + 1) & (RECEIVED_SIZE - 1);
    return true;
}
