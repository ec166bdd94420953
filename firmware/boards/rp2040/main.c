/* A board to be bought: a Raspberry Pi Pico, or any with an RP2040. To the host by its own USB.
 *
 *   GP26         converter: the common pin of the multiplexers that read
 *   GP0 ... 5    address of the electrode that is read
 *   GP6 ... 11   address of the electrode that is grounded
 *   GP12         low: one is grounded
 *   GP23         high: a Pico's regulator makes less noise
 *
 * Multiplexers as in multiplexers.h. PWM slice 0 ticks, without a pin; at a tick the
 * converter takes what the multiplexer was set to at the tick before, so that the time to settle is
 * the timer's and not the software's. It comes before all other interrupts.
 */
#include <math.h>

#include "multiplexers.h"
#include "registers.h"
#include "tt_board.h"
#include "tt_device.h"
#include "usb.h"

#define CLOCK_MHZ 125u
#define WATCHDOG_MS 500u
#define LONG_ENOUGH 1000u /* turns of a loop that waits for the converter */

#define QUIET_REGULATOR (1u << 23)
#define OUTPUTS (ADDRESS | ADDRESS << GROUND_SHIFT | GROUND_OFF | QUIET_REGULATOR)
#define ANALOG_PIN 26u

static struct tt_device device;
static uint32_t mask_before;

static const struct tt_facts facts = {
    MULTIPLEXER_FACTS,
    .line_rate = 0,
    .address = 0,
    .name = "rp2040",
};

/* ---- what the library asks for ---- */

uint64_t tt_board_time(void)
{
    uint32_t high = TIMER_RAWH, low, before;
    do {
        before = high;
        low = TIMER_RAWL;
        high = TIMER_RAWH;
    } while (high != before);
    return (uint64_t)high << 32 | low;
}

void tt_board_lock(void)
{
    mask_before = interrupts_off();
}

void tt_board_unlock(void)
{
    interrupts_restore(mask_before);
}

static void set_pins(uint32_t pins, uint32_t value)
{
    SIO_OUT_XOR = (SIO_OUT ^ value) & pins;
}

void tt_board_ground(uint16_t electrode)
{
    SIO_OUT_SET = GROUND_OFF; /* break before make */
    if (electrode == TT_GROUND_NONE)
        return;
    set_pins(ADDRESS << GROUND_SHIFT, (uint32_t)electrode << GROUND_SHIFT);
    SIO_OUT_CLEAR = GROUND_OFF;
}

void tt_board_select(uint16_t electrode)
{
    set_pins(ADDRESS, electrode);
}

uint32_t tt_board_convert(void)
{
    uint32_t turns = LONG_ENOUGH, status;
    ADC_CS = ADC_CS_ENABLE | ADC_CS_START;
    do {
        status = ADC_CS;
    } while (!(status & ADC_CS_READY) && --turns > 0);
    return turns > 0 && !(status & ADC_CS_ERROR) ? ADC_RESULT & 0xFFFu : TT_NONE;
}

float tt_board_temperature(void)
{
    return NAN; /* the one of the chip is not the sheet's */
}

void tt_board_send(void)
{
    usb_wake();
}

/* ---- interrupts ---- */

static void tick(void)
{
    PWM_INTR = PWM0;
    (void)tt_scan_tick(&device.scan);
}

__attribute__((section(".irq_vectors"), used)) static void (*const irq_vectors[IRQS])(void) = {
    [IRQ_PWM] = tick,
    [IRQ_USB] = usb_interrupt,
};

/* ---- hardware ---- */

static void wait_for(const volatile uint32_t *place, uint32_t mask)
{
    while (!(*place & mask)) {
    }
}

static void leave_reset(uint32_t blocks)
{
    SET_BITS(RESETS) = blocks;
    CLEAR_BITS(RESETS) = blocks;
    while ((RESETS_DONE & blocks) != blocks) {
    }
}

/* 12 MHz * multiple / first / second; 750 to 1600 MHz between. */
static void start_pll(uint32_t pll, uint32_t multiple, uint32_t first, uint32_t second)
{
    PLL_CS(pll) = 1;
    PLL_FBDIV(pll) = multiple;
    CLEAR_BITS(pll + PLL_PWR) = PLL_PWR_OFF;
    wait_for(&PLL_CS(pll), PLL_CS_LOCK);
    PLL_PRIM(pll) = first << 16 | second << 12;
    CLEAR_BITS(pll + PLL_PWR) = PLL_PWR_DIVIDERS_OFF;
}

/* The core at 125 MHz, USB and converter at 48 MHz, the timer at 1 MHz; all from the crystal. */
static void start_clocks(void)
{
    XOSC_STARTUP = XOSC_STARTUP_4_MS;
    XOSC_CTRL = XOSC_CTRL_ON;
    wait_for(&XOSC_STATUS, XOSC_STATUS_STABLE);
    CLK_SYS_CTRL = 0; /* behind a reset of the core alone the PLL still runs */
    wait_for(&CLK_SYS_SELECTED, 1u);
    CLK_REF_CTRL = CLK_REF_XOSC;
    wait_for(&CLK_REF_SELECTED, 1u << CLK_REF_XOSC);
    leave_reset(RESET_PLL_SYS | RESET_PLL_USB);
    start_pll(PLL_SYS, 125, 6, 2);
    start_pll(PLL_USB, 100, 5, 5);
    CLK_SYS_CTRL = CLK_SYS_PLL;
    wait_for(&CLK_SYS_SELECTED, 1u << CLK_SYS_PLL);
    CLK_USB_CTRL = CLK_ENABLE_PLL_USB;
    CLK_ADC_CTRL = CLK_ENABLE_PLL_USB;
    WATCHDOG_TICK = WATCHDOG_TICK_12_MHZ;
    leave_reset(RESET_ADC | RESET_IO | RESET_PADS | RESET_PWM | RESET_TIMER | RESET_USB);
}

static void start_pins(void)
{
    uint32_t pin;
    SIO_OUT_SET = GROUND_OFF | QUIET_REGULATOR;
    SIO_OE_SET = OUTPUTS;
    for (pin = 0; pin < 32u; pin++)
        if (OUTPUTS >> pin & 1u)
            IO_CTRL(pin) = IO_CTRL_SIO;
    PAD(ANALOG_PIN) = PAD_ANALOG;
    ADC_CS = ADC_CS_ENABLE;
    wait_for(&ADC_CS, ADC_CS_READY);
}

static void start_ticks(void)
{
    PWM0_TOP = CLOCK_MHZ * TICK_US - 1u;
    PWM_INTE = PWM0;
    PWM0_CSR = 1;
    NVIC_IPR1 = NVIC_PWM_FIRST;
    NVIC_ENABLE(IRQ_PWM);
}

/* Random bits, and a count that survives a reset. */
static uint32_t boot_id(void)
{
    uint32_t bits = 0, turn;
    for (turn = 0; turn < 32; turn++)
        bits = bits << 1 | (ROSC_RANDOMBIT & 1u);
    WATCHDOG_SCRATCH0 = WATCHDOG_SCRATCH0 + 1u;
    return bits ^ WATCHDOG_SCRATCH0;
}

static void feed_watchdog(void)
{
    WATCHDOG_LOAD = 2u * 1000u * WATCHDOG_MS; /* it counts twice a µs (erratum RP2040-E1) */
}

int main(void)
{
    struct tt_facts own = facts;
    start_clocks();
    start_pins();
    own.boot = boot_id();
    tt_device_init(&device, &own);
    start_ticks();
    usb_start(&device.received, &device.sending, own.name, own.serial);
    PSM_WDSEL = PSM_ALL_BUT_OSCILLATORS;
    feed_watchdog();
    WATCHDOG_CTRL = WATCHDOG_CTRL_ENABLE;
    for (;;) {
        feed_watchdog();
        if (tt_device_poll(&device))
            usb_wake(); /* there is room for commands again */
    }
}
