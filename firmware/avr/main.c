#include <avr/interrupt.h>

#include "clock.h"
#include "finger.h"
#include "twi.h"
#include "uart.h"

int main(void)
{
    static struct finger finger;
    clock_init();
    twi_init();
    uart_init();
    sei();
    finger_boot(&finger);
    for (;;) {
        finger_step(&finger);
    }
}
