/* The board as its own machine code on a simulated ATmega328P: real timer, USART, two-wire interface and EEPROM code. */
#include <avr_ioport.h>
#include <avr_twi.h>
#include <avr_uart.h>
#include <sim_avr.h>
#include <sim_elf.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "bench.h"
#include "device.h"

enum {
    MHZ = 16,
    RESET_LINES_FIRST_BIT = 2,
    TWCR_ADDRESS = 0xBC,
    TWINT_BIT = 0x80,
    BUS_BYTE_CYCLES = 360, /* nine bits at 400 kHz */
};

static avr_t *avr;
static avr_irq_t *twi;
static uint8_t reset_pins_out; /* DDRD */
static uint8_t reset_pins_high; /* PORTD */
static bool receiver_full;
static avr_cycle_count_t bus_byte_end;

uint64_t device_now(void)
{
    return avr->cycle / MHZ;
}

static void on_reset_lines(void)
{
    const uint8_t low = (uint8_t)((reset_pins_out & ~reset_pins_high) >> RESET_LINES_FIRST_BIT);
    for (int k = 0; k < MODULES; k++) {
        chip_hold(&bench_bus.chips[k], low >> k & 1, device_now());
    }
}

static void on_direction(avr_irq_t *irq, uint32_t value, void *unused)
{
    (void)irq, (void)unused;
    reset_pins_out = (uint8_t)value;
    on_reset_lines();
}

static void on_port(avr_irq_t *irq, uint32_t value, void *unused)
{
    (void)irq, (void)unused;
    reset_pins_high = (uint8_t)value;
    on_reset_lines();
}

static void tell_master(uint8_t condition, uint8_t address, uint8_t data)
{
    avr_raise_irq(twi + TWI_IRQ_INPUT, avr_twi_irq_msg(condition, address, data));
}

/* simavr 1.6 leaves TWINT set when it is polled and a one is written to clear it. */
static void on_twcr(struct avr_t *of, avr_io_addr_t address, uint8_t value, void *unused)
{
    (void)unused;
    if (value & TWINT_BIT) {
        of->data[address] &= (uint8_t)~TWINT_BIT;
    }
}

/* simavr 1.6 takes 9 us or no time at all for a byte, whatever the bit rate: the processor waits for the rest. */
static void take_a_bytes_time(bool stop)
{
    if (avr->cycle < bus_byte_end) {
        avr->cycle = bus_byte_end;
    }
    bus_byte_end = avr->cycle + (stop ? 0 : BUS_BYTE_CYCLES);
}

static void on_twi(avr_irq_t *irq, uint32_t value, void *unused)
{
    (void)irq, (void)unused;
    const avr_twi_msg_irq_t message = {.u.v = value};
    const uint8_t address = (uint8_t)message.u.twi.addr;
    take_a_bytes_time(message.u.twi.msg & TWI_COND_STOP);
    if (message.u.twi.msg & TWI_COND_STOP) {
        bench_bus.selected = 0;
    }
    if (message.u.twi.msg & TWI_COND_START && bus_address(&bench_bus, address >> 1, address & 1, device_now())) {
        tell_master(TWI_COND_ACK, address, 1);
    }
    if (message.u.twi.msg & TWI_COND_WRITE && bench_bus.selected != 0) {
        tell_master(TWI_COND_ACK, address, 1);
        bus_write(&bench_bus, (uint8_t)message.u.twi.data, device_now());
    }
    if (message.u.twi.msg & TWI_COND_READ && bench_bus.selected != 0) {
        tell_master(TWI_COND_READ, address, bus_read(&bench_bus, device_now()));
    }
}

static void on_sent(avr_irq_t *irq, uint32_t value, void *unused)
{
    (void)irq, (void)unused;
    bench_sent((uint8_t)value);
}

/* simavr begins to receive a byte when the one before is read: it falls behind a full line, which then has to wait. */
static void on_room(avr_irq_t *irq, uint32_t value, void *unused)
{
    (void)irq, (void)value, (void)unused;
    receiver_full = false;
}

static void on_no_room(avr_irq_t *irq, uint32_t value, void *unused)
{
    (void)irq, (void)value, (void)unused;
    receiver_full = true;
}

static avr_cycle_count_t next_byte_in(avr_t *of, avr_cycle_count_t when, void *unused)
{
    (void)of, (void)unused;
    uint8_t byte;
    if (!receiver_full && bench_arrives(&byte)) {
        avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT), byte);
    }
    return when + (avr_cycle_count_t)BENCH_BYTE_NS * MHZ / 1000;
}

static void attach(uint32_t from, int irq, avr_irq_notify_t notify)
{
    avr_irq_register_notify(avr_io_getirq(avr, from, irq), notify, NULL);
}

const char *device_power_up(const char *elf)
{
    elf_firmware_t firmware = {0};
    const int answers = dup(STDOUT_FILENO); /* simavr tells on standard output what it loads */
    dup2(STDERR_FILENO, STDOUT_FILENO);
    const bool loaded = elf != NULL && elf_read_firmware(elf, &firmware) == 0;
    fflush(stdout);
    dup2(answers, STDOUT_FILENO);
    close(answers);
    if (!loaded) {
        return "give the machine code: finger.elf";
    }
    avr = avr_make_mcu_by_name("atmega328p");
    if (avr == NULL || avr_init(avr) != 0) {
        return "this simavr knows no ATmega328P";
    }
    avr->frequency = MHZ * 1000000u;
    avr->log = LOG_ERROR;
    avr_load_firmware(avr, &firmware);
    avr_register_io_write(avr, TWCR_ADDRESS, on_twcr, NULL);
    uint32_t no_flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &no_flags);
    twi = avr_io_getirq(avr, AVR_IOCTL_TWI_GETIRQ(0), 0);
    attach(AVR_IOCTL_TWI_GETIRQ(0), TWI_IRQ_OUTPUT, on_twi);
    attach(AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT, on_sent);
    attach(AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XON, on_room);
    attach(AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XOFF, on_no_room);
    attach(AVR_IOCTL_IOPORT_GETIRQ('D'), IOPORT_IRQ_DIRECTION_ALL, on_direction);
    attach(AVR_IOCTL_IOPORT_GETIRQ('D'), IOPORT_IRQ_REG_PORT, on_port);
    avr_cycle_timer_register_usec(avr, 100, next_byte_in, NULL);
    return NULL;
}

void device_reset(void)
{
    avr_reset(avr);
    avr_cycle_timer_register_usec(avr, 100, next_byte_in, NULL);
}

void device_advance(uint64_t until_us)
{
    while (device_now() < until_us) {
        const int state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed) {
            abort();
        }
    }
}
