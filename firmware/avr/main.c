#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/wdt.h>

#include "clock.h"
#include "finger.h"
#include "twi.h"
#include "uart.h"

/* Before all else: after a reset by the watchdog it still runs, at its shortest time. */
__attribute__((naked, used, section(".init3"))) static void stop_watchdog(void)
{
    MCUSR = 0;
    wdt_disable();
}

int main(void)
{
    static struct finger finger;
#ifdef USBCON
    USBCON = 0; /* the boot loader may have left the USB interface on, whose interrupts nobody serves here */
#endif
    wdt_enable(WDTO_250MS); /* a step takes 2 ms at most; whatever hangs for longer is restarted, with a new boot number */
    clock_init();
    twi_init();
    uart_init();
    sei();
    finger_boot(&finger);
    for (;;) {
        wdt_reset();
        finger_step(&finger);
    }
}
