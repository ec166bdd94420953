/* QEMU's machine mps2-an385 (Cortex-M3) as a board; a table of readings stands for the sheet.
 *
 * Registers are those of Arm's Application Note AN385 and of the Cortex-M System Design Kit (CMSDK):
 * UART0 to the host, TIMER0 for the scan, the counter of the FPGA's system registers for the time.
 * An emulated interrupt costs more than a conversion, so that one takes a whole row here.
 */
#include <math.h>

#include "core.h"
#include "readings.h" /* made by make_readings.py */
#include "tt_board.h"
#include "tt_device.h"

#define CLOCK 25000000u /* Hz */
#define TICKS_PER_S 4000u

#define UART0 0x40004000u
#define UART_DATA REGISTER(UART0 + 0x00u)
#define UART_STATE REGISTER(UART0 + 0x04u)
#define UART_CONTROL REGISTER(UART0 + 0x08u)
#define UART_INTERRUPTS REGISTER(UART0 + 0x0Cu)
#define UART_BAUD_DIVIDER REGISTER(UART0 + 0x10u)
#define UART_STATE_SENDING_FULL 1u
#define UART_STATE_RECEIVED 2u
#define UART_CONTROL_ALL 0x0Fu /* send, receive, and an interrupt for each */
#define UART_INTERRUPT_SENT 1u
#define UART_INTERRUPT_RECEIVED 2u

#define TIMER0 0x40000000u
#define TIMER_CONTROL REGISTER(TIMER0 + 0x00u)
#define TIMER_VALUE REGISTER(TIMER0 + 0x04u)
#define TIMER_RELOAD REGISTER(TIMER0 + 0x08u)
#define TIMER_INTERRUPT REGISTER(TIMER0 + 0x0Cu)
#define TIMER_ENABLE_WITH_INTERRUPT 9u

#define COUNTER REGISTER(0x40028018u)
#define COUNTER_PRESCALE REGISTER(0x4002801Cu)

#define BOOT_COUNTER REGISTER(0x203FFFF0u)

enum { IRQ_UART0_RECEIVED = 0, IRQ_UART0_SENT = 1, IRQ_TIMER0 = 8 };

typedef char all_electrodes_have_memory[TABLE_ELECTRODES <= TT_MAX_ELECTRODES ? 1 : -1];

static struct tt_device device;
static uint16_t grounded, selected;
static uint32_t last_count, high_count;

static const struct tt_facts facts = {
    .electrodes = TABLE_ELECTRODES,
    .settle_ground = 1,
    .settle_read = 1,
    .tick = 1.0f / ((float)TICKS_PER_S * (TABLE_ELECTRODES + 1.0f)),
    .bits = TABLE_BITS,
    .zero = TABLE_ZERO,
    .scale = TABLE_SCALE,
    .drive_voltage = TABLE_DRIVE_VOLTAGE,
    .rate = 10.0f,
    .line_rate = 0,
    .address = TABLE_ADDRESS,
    .name = "qemu",
    .firmware = "2.0.0",
    .serial = "mps2-an385",
};

/* The counter has 32 bits of µs; the timer's interrupt looks at it often enough to see it wrap. */
uint64_t tt_board_time(void)
{
    uint32_t before = interrupts_off(), count = COUNTER;
    uint64_t time;
    if (count < last_count)
        high_count++;
    last_count = count;
    time = (uint64_t)high_count << 32 | count;
    interrupts_restore(before);
    return time;
}

static uint32_t mask_before;

void tt_board_lock(void)
{
    mask_before = interrupts_off();
}

void tt_board_unlock(void)
{
    interrupts_restore(mask_before);
}

void tt_board_ground(uint16_t electrode)
{
    grounded = electrode;
}

void tt_board_select(uint16_t electrode)
{
    selected = electrode;
}

uint32_t tt_board_convert(void)
{
    return table[device.scan.sequence % TABLE_FRAMES][grounded][selected];
}

float tt_board_temperature(void)
{
    return TABLE_TEMPERATURE;
}

/* The interrupt comes when a byte has left: the first one has to be sent from here. */
void tt_board_send(void)
{
    uint32_t before = interrupts_off();
    uint8_t byte;
    while (!(UART_STATE & UART_STATE_SENDING_FULL) && tt_queue_get(&device.sending, &byte))
        UART_DATA = byte;
    interrupts_restore(before);
}

static void uart_sent(void)
{
    UART_INTERRUPTS = UART_INTERRUPT_SENT;
    tt_board_send();
}

static void uart_received(void)
{
    UART_INTERRUPTS = UART_INTERRUPT_RECEIVED;
    while (UART_STATE & UART_STATE_RECEIVED) {
        uint8_t byte = (uint8_t)UART_DATA;
        (void)tt_queue_put(&device.received, &byte, 1);
    }
}

static void timer_tick(void)
{
    TIMER_INTERRUPT = 1u;
    (void)tt_board_time();
    while (tt_scan_tick(&device.scan)) {
    }
}

__attribute__((section(".irq_vectors"), used)) static void (*const irq_vectors[32])(void) = {
    [IRQ_UART0_RECEIVED] = uart_received,
    [IRQ_UART0_SENT] = uart_sent,
    [IRQ_TIMER0] = timer_tick,
};

int main(void)
{
    struct tt_facts own = facts;
    own.boot = ++BOOT_COUNTER;
    COUNTER_PRESCALE = CLOCK / 1000000u - 1u;
    COUNTER = 0;
    tt_device_init(&device, &own);
    UART_BAUD_DIVIDER = 16u;
    UART_CONTROL = UART_CONTROL_ALL;
    TIMER_RELOAD = CLOCK / TICKS_PER_S - 1u;
    TIMER_VALUE = TIMER_RELOAD;
    TIMER_CONTROL = TIMER_ENABLE_WITH_INTERRUPT;
    NVIC_PRIORITY(IRQ_TIMER0, 0);
    NVIC_PRIORITY(IRQ_UART0_RECEIVED, 4);
    NVIC_PRIORITY(IRQ_UART0_SENT, 8);
    NVIC_ENABLE(IRQ_UART0_RECEIVED);
    NVIC_ENABLE(IRQ_UART0_SENT);
    NVIC_ENABLE(IRQ_TIMER0);
    for (;;) {
        if (!tt_device_poll(&device))
            __asm__ volatile("wfi");
    }
}
