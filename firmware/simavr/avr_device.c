/* The board as its own machine code on a simulated AVR: real timer, USART, two-wire interface and EEPROM code. */
#include <avr_ioport.h>
#include <avr_twi.h>
#include <avr_uart.h>
#include <sim_avr.h>
#include <sim_elf.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "bench.h"
#include "device.h"

#if defined(atmega2560)
static const char MCU[] = "atmega2560";
enum { BUS_PORT = 'D', SCL_BIT = 0, RESET_PORT = 'A', RESET_FIRST_BIT = 0, UART = '0' };
#elif defined(atmega32u4)
static const char MCU[] = "atmega32u4";
enum { BUS_PORT = 'D', SCL_BIT = 0, RESET_PORT = 'B', RESET_FIRST_BIT = 1, UART = '1' };
#else
static const char MCU[] = "atmega328p";
enum { BUS_PORT = 'C', SCL_BIT = 5, RESET_PORT = 'D', RESET_FIRST_BIT = 2, UART = '0' };
#endif

enum {
    MHZ = 16,
    TWCR_ADDRESS = 0xBC,
    TWINT_BIT = 0x80,
    BUS_BYTE_CYCLES = 360, /* nine bits at 400 kHz */
};

static avr_t *avr;
static avr_irq_t *twi;
static uint8_t reset_pins_out;
static uint8_t reset_pins_high;
static uint8_t bus_pins_out;
static int frozen_at = -1; /* the instruction that was replaced by one that never ends */
static uint8_t frozen[2];
static bool receiver_full;
static avr_cycle_count_t bus_byte_end;

uint64_t device_now(void)
{
    return avr->cycle / MHZ;
}

static void on_reset_lines(void)
{
    const uint8_t low = (uint8_t)((reset_pins_out & ~reset_pins_high) >> RESET_FIRST_BIT);
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

static void on_bus_direction(avr_irq_t *irq, uint32_t value, void *unused)
{
    (void)irq, (void)unused;
    if (bus_pins_out & ~value & 1u << SCL_BIT) { /* let go, so it rises */
        bus_clock(&bench_bus);
    }
    bus_pins_out = (uint8_t)value;
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

/* On a bus whose data line is held low the interface gets no step done. */
static uint8_t on_twcr_read(struct avr_t *of, avr_io_addr_t address, void *unused)
{
    (void)unused;
    return bench_bus.stuck_clocks != 0 ? of->data[address] & (uint8_t)~TWINT_BIT : of->data[address];
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
        avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ(UART), UART_IRQ_INPUT), byte);
    }
    return when + (avr_cycle_count_t)BENCH_BYTE_NS * MHZ / 1000;
}

static void attach(uint32_t from, int irq, avr_irq_notify_t notify)
{
    avr_irq_register_notify(avr_io_getirq(avr, from, irq), notify, NULL);
}

/* However it came about: the simulator forgets what was to happen. */
static void on_reset(avr_t *of)
{
    if (frozen_at >= 0) {
        memcpy(of->flash + frozen_at, frozen, sizeof frozen);
        frozen_at = -1;
    }
    avr_cycle_timer_register_usec(of, 100, next_byte_in, NULL);
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
    avr = avr_make_mcu_by_name(MCU);
    if (avr == NULL || avr_init(avr) != 0) {
        return "this simavr does not know the processor";
    }
    avr->reset = on_reset;
    avr->frequency = MHZ * 1000000u;
    avr->log = LOG_ERROR;
    avr_load_firmware(avr, &firmware);
    avr_register_io_write(avr, TWCR_ADDRESS, on_twcr, NULL);
    avr_register_io_read(avr, TWCR_ADDRESS, on_twcr_read, NULL);
    uint32_t no_flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS(UART), &no_flags);
    twi = avr_io_getirq(avr, AVR_IOCTL_TWI_GETIRQ(0), 0);
    attach(AVR_IOCTL_TWI_GETIRQ(0), TWI_IRQ_OUTPUT, on_twi);
    attach(AVR_IOCTL_UART_GETIRQ(UART), UART_IRQ_OUTPUT, on_sent);
    attach(AVR_IOCTL_UART_GETIRQ(UART), UART_IRQ_OUT_XON, on_room);
    attach(AVR_IOCTL_UART_GETIRQ(UART), UART_IRQ_OUT_XOFF, on_no_room);
    attach(AVR_IOCTL_IOPORT_GETIRQ(RESET_PORT), IOPORT_IRQ_DIRECTION_ALL, on_direction);
    attach(AVR_IOCTL_IOPORT_GETIRQ(RESET_PORT), IOPORT_IRQ_REG_PORT, on_port);
    attach(AVR_IOCTL_IOPORT_GETIRQ(BUS_PORT), IOPORT_IRQ_DIRECTION_ALL, on_bus_direction);
    avr_cycle_timer_register_usec(avr, 100, next_byte_in, NULL);
    return NULL;
}

void device_reset(void)
{
    avr_reset(avr);
}

bool device_freeze(void)
{
    static const uint8_t JUMP_TO_ITSELF[2] = {0xFF, 0xCF};
    frozen_at = (int)avr->pc;
    memcpy(frozen, avr->flash + frozen_at, sizeof frozen);
    memcpy(avr->flash + frozen_at, JUMP_TO_ITSELF, sizeof frozen);
    return true;
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
