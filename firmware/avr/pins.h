/* Where the bus, the reset lines and the serial line are: six reset lines in a row of one port, the lowest first. */
#ifndef PINS_H
#define PINS_H

#include <avr/io.h>

#if defined(__AVR_ATmega328P__) /* Uno, Nano, Pro Mini: A4, A5; D2 to D7; D0, D1. An ATmega328PB runs the same code. */
#define BUS_PORT PORTC
#define BUS_DDR DDRC
#define SDA _BV(PC4)
#define SCL _BV(PC5)
#define RESET_PORT PORTD
#define RESET_DDR DDRD
#define RESET_FIRST _BV(PD2)
#define UART_RX_vect USART_RX_vect
#define UART_EMPTY_vect USART_UDRE_vect

#elif defined(__AVR_ATmega2560__) /* Mega: D20, D21; D22 to D27; D0, D1 */
#define BUS_PORT PORTD
#define BUS_DDR DDRD
#define SDA _BV(PD1)
#define SCL _BV(PD0)
#define RESET_PORT PORTA
#define RESET_DDR DDRA
#define RESET_FIRST _BV(PA0)
#define UART_RX_vect USART0_RX_vect
#define UART_EMPTY_vect USART0_UDRE_vect

#elif defined(__AVR_ATmega32U4__) /* Micro, Pro Micro, Leonardo: D2, D3; SCK, MOSI, MISO, D8, D9, D10; D0, D1 */
#define BUS_PORT PORTD
#define BUS_DDR DDRD
#define SDA _BV(PD1)
#define SCL _BV(PD0)
#define RESET_PORT PORTB
#define RESET_DDR DDRB
#define RESET_FIRST _BV(PB1)
#define UART_RX_vect USART1_RX_vect
#define UART_EMPTY_vect USART1_UDRE_vect

#else
#error "no pins are known for this processor: add them here"
#endif

#if defined(__AVR_ATmega32U4__) /* its only USART is the second of the others */
#define UART_DATA UDR1
#define UART_A UCSR1A
#define UART_B UCSR1B
#define UART_C UCSR1C
#define UART_BAUD UBRR1
#else
#define UART_DATA UDR0
#define UART_A UCSR0A
#define UART_B UCSR0B
#define UART_C UCSR0C
#define UART_BAUD UBRR0
#endif
enum { /* bits of the three control registers: the same in all USARTs */
    UART_DOUBLE_SPEED = _BV(1),
    UART_SENT = _BV(6),
    UART_RECEIVE = _BV(4) | _BV(7), /* with its interrupt */
    UART_SEND = _BV(3),
    UART_EMPTY_INTERRUPT = _BV(5),
    UART_8_BITS = _BV(1) | _BV(2),
};

#endif
