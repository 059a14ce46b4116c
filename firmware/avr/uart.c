#include "uart.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <string.h>
#include <util/atomic.h>

#include "hal.h"

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
    UCSR0A = _BV(U2X0);
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UBRR0 = BAUD_DIVIDER;
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

ISR(USART_RX_vect)
{
    const uint8_t byte = UDR0;
    const uint8_t next = (received_in + 1) & (RECEIVED_SIZE - 1);
    if (next != received_out) { /* else lost: the checksum of its frame will tell */
        received[received_in] = byte;
        received_in = next;
    }
}

ISR(USART_UDRE_vect)
{
    UDR0 = sending[sent_count++];
    UCSR0A = _BV(U2X0) | _BV(TXC0); /* clears "transmission complete" */
    if (sent_count == sending_count) {
        UCSR0B &= (uint8_t)~_BV(UDRIE0);
    }
}

bool hal_uart_idle(void)
{
    return sending_count == 0 || (sent_count == sending_count && (UCSR0A & _BV(TXC0)));
}

void hal_uart_send(const uint8_t *data, uint8_t count)
{
    memcpy(sending, data, count);
    sending_count = count;
    sent_count = 0;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) /* also keeps the compiler from filling the buffer later */
    {
        UCSR0B |= _BV(UDRIE0);
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
