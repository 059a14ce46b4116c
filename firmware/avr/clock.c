#include "clock.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "hal.h"

_Static_assert(F_CPU == 16000000UL, "timer 1 counts half microseconds only at 16 MHz");

static volatile uint32_t overflows; /* of 32.768 ms each */

ISR(TIMER1_OVF_vect)
{
    overflows++;
}

void clock_init(void)
{
    TCCR1A = 0;
    TCCR1B = _BV(CS11); /* clock / 8 */
    TIMSK1 = _BV(TOIE1);
}

uint32_t hal_micros(void)
{
    uint32_t whole;
    uint16_t halves;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        whole = overflows;
        halves = TCNT1;
        if ((TIFR1 & _BV(TOV1)) && halves < 0x8000) { /* it overflowed before TCNT1 was read, uncounted as yet */
            whole++;
        }
    }
    return (whole << 15) + (halves >> 1);
}
