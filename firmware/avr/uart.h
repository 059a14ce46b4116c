#ifndef UART_H
#define UART_H

/* USART 0 at 115200 baud, 8N1. */
void uart_init(void);

#endif
