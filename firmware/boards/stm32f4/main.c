/* A board to be bought: NUCLEO-F446RE, or any with an STM32F405 or STM32F446.
 *
 *   PA0          converter: the common pin of the multiplexers that read
 *   PC0 ... 5    address of the electrode that is read
 *   PC6 ... 11   address of the electrode that is grounded
 *   PC12         low: one is grounded
 *   PA2, PA3     USART2, 2 Mbit/s: to the host (on a NUCLEO also to the USB of its programmer)
 *
 * Multiplexers as in multiplexers.h.
 *
 * Timer TIM2 ticks; at a tick the converter takes what the multiplexer was set to at the tick
 * before, so that the time to settle is the timer's and not the software's. It comes before all
 * other interrupts. TIM5 is the time in µs. The clock comes from outside: 8 MHz from the programmer
 * of a NUCLEO, or a crystal (-DHSE_MHZ=12 -DHSE_BYPASS=0). Where none comes the internal oscillator
 * serves, and each stream begins with an ERROR that says so: it is 1 % off, too much for the host.
 *
 * With EMULATED it runs in QEMU's machine netduinoplus2, whose models of line, timer and
 * converter lack interrupts and the end of a conversion: there the main loop calls what they would.
 */
#include <math.h>

#include "multiplexers.h"
#include "registers.h"
#include "tt_board.h"
#include "tt_device.h"

#define TIMER_CLOCK 84000000u /* Hz, of TIM2 and TIM5 */
#define LINE_RATE 2000000u
#define LINE_DIVIDER 0x25u /* 42 MHz / 8 / 2 Mbit/s = 2.625: 2 and 5/8 */
#define WATCHDOG_MS 500u
#define LONG_ENOUGH 10000u /* turns of a loop that waits for hardware */

#define SET_PINS(mask, value) (GPIO_BSRR(GPIOC) = ((mask) << 16) | (value))

#ifndef HSE_MHZ
#define HSE_MHZ 8u
#endif
#ifndef HSE_BYPASS
#define HSE_BYPASS 1
#endif
#define HSI_MHZ 16u

#ifndef BUS_ADDRESS
#define BUS_ADDRESS 0
#endif

static struct tt_device device;
static uint32_t last_count, high_count, mask_before;
__attribute__((section(".kept"))) static uint32_t boots;

static const struct tt_facts facts = {
    MULTIPLEXER_FACTS,
    .line_rate = LINE_RATE,
    .address = BUS_ADDRESS,
    .name = "stm32f4",
};

/* ---- what the library asks for ---- */

/* TIM5 wraps after 71 minutes; each tick looks at it. */
uint64_t tt_board_time(void)
{
    uint32_t before = interrupts_off(), count = TIM_CNT(TIM5);
    uint64_t time;
    if (count < last_count)
        high_count++;
    last_count = count;
    time = (uint64_t)high_count << 32 | count;
    interrupts_restore(before);
    return time;
}

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
    SET_PINS(GROUND_OFF, GROUND_OFF); /* break before make */
    if (electrode == TT_GROUND_NONE)
        return;
    SET_PINS(ADDRESS << GROUND_SHIFT, (uint32_t)electrode << GROUND_SHIFT);
    SET_PINS(GROUND_OFF, 0u);
}

void tt_board_select(uint16_t electrode)
{
    SET_PINS(ADDRESS, electrode);
}

uint32_t tt_board_convert(void)
{
    uint32_t turns = LONG_ENOUGH;
    ADC1_SR = 0;
    ADC1_CR2 |= ADC_CR2_SWSTART;
#ifndef EMULATED
    while (!(ADC1_SR & ADC_SR_EOC) && --turns > 0) {
    }
#endif
    return turns > 0 ? ADC1_DR & 0xFFFu : TT_NONE;
}

float tt_board_temperature(void)
{
    return NAN; /* the one of the chip is not the sheet's */
}

void tt_board_send(void)
{
    USART2_CR1 |= USART_CR1_TXEIE;
}

/* ---- interrupts ---- */

static void usart(void)
{
    uint32_t status = USART2_SR;
    uint8_t byte;
    if (status & (USART_SR_RXNE | USART_SR_ORE)) { /* reading ends either */
        byte = (uint8_t)USART2_DR;
        if (status & USART_SR_RXNE)
            (void)tt_queue_put(&device.received, &byte, 1);
    }
    if (!(status & USART_SR_TXE) || !(USART2_CR1 & USART_CR1_TXEIE))
        return;
    if (tt_queue_get(&device.sending, &byte))
        USART2_DR = byte;
    else
        USART2_CR1 &= ~USART_CR1_TXEIE;
}

static void tick(void)
{
    TIM_SR(TIM2) = 0;
    (void)tt_board_time();
    (void)tt_scan_tick(&device.scan);
}

__attribute__((section(".irq_vectors"), used)) static void (*const irq_vectors[IRQS])(void) = {
    [IRQ_TIM2] = tick,
    [IRQ_USART2] = usart,
};

/* ---- hardware ---- */

static bool wait_for(const volatile uint32_t *place, uint32_t mask, uint32_t value)
{
    uint32_t turns = LONG_ENOUGH;
    while ((*place & mask) != value && --turns > 0) {
    }
    return turns > 0;
}

/* Of any source 2 MHz * 168 / 2 = 168 MHz; APB1 42 MHz, APB2 84 MHz, timers on APB1 84 MHz. False
 * where the clock from outside does not come. */
static bool start_clocks(void)
{
    bool exact;
    RCC_CR |= HSE_BYPASS ? RCC_CR_HSEBYP | RCC_CR_HSEON : RCC_CR_HSEON;
    exact = wait_for(&RCC_CR, RCC_CR_HSERDY, RCC_CR_HSERDY);
    RCC_PLLCFGR = RCC_PLLCFGR_N168_P2_Q7_R2
        | (exact ? RCC_PLLCFGR_HSE | HSE_MHZ / 2u : HSI_MHZ / 2u);
    RCC_CR |= RCC_CR_PLLON;
    (void)wait_for(&RCC_CR, RCC_CR_PLLRDY, RCC_CR_PLLRDY);
    FLASH_ACR = FLASH_ACR_5_WAITS_AND_CACHES;
    RCC_CFGR = RCC_CFGR_PPRE1_4 | RCC_CFGR_PPRE2_2;
    RCC_CFGR |= RCC_CFGR_SW_PLL;
    (void)wait_for(&RCC_CFGR, RCC_CFGR_SWS, RCC_CFGR_SWS_PLL);
    RCC_AHB1ENR |= RCC_AHB1ENR_GPIOA | RCC_AHB1ENR_GPIOC;
    RCC_APB1ENR |= RCC_APB1ENR_TIM2 | RCC_APB1ENR_TIM5 | RCC_APB1ENR_USART2;
    RCC_APB2ENR |= RCC_APB2ENR_ADC1;
    (void)RCC_APB2ENR; /* two cycles until the peripherals listen */
    return exact;
}

static void start_pins(void)
{
    GPIO_BSRR(GPIOC) = GROUND_OFF;
    GPIO_MODER(GPIOC) = (GPIO_MODER(GPIOC) & ~0x03FFFFFFu) | 0x01555555u; /* PC0 ... 12 out */
    GPIO_MODER(GPIOA) = (GPIO_MODER(GPIOA) & ~0xF3u) | 0xA3u; /* PA0 analog, PA2, 3 alternate */
    GPIO_AFRL(GPIOA) = (GPIO_AFRL(GPIOA) & ~0xFF00u) | 0x7700u;
    GPIO_OSPEEDR(GPIOA) |= 2u << 4;
    GPIO_PUPDR(GPIOA) = (GPIO_PUPDR(GPIOA) & ~0xC0u) | 0x40u; /* no noise without a cable */
}

/* 84 MHz / 4 = 21 MHz; 28 cycles to sample and 12 to convert are 1.9 µs. */
static void start_converter(void)
{
    ADC_CCR = ADC_CCR_CLOCK_4;
    ADC1_CR1 = 0;
    ADC1_SQR1 = 0;
    ADC1_SQR3 = 0;
    ADC1_SMPR2 = ADC_SMPR2_28_CYCLES;
    ADC1_CR2 = ADC_CR2_ADON;
}

static void start_timer(uint32_t timer, uint32_t prescale, uint32_t period)
{
    TIM_PSC(timer) = prescale - 1u;
    TIM_ARR(timer) = period - 1u;
    TIM_CR1(timer) = TIM_CR1_CEN;
    TIM_EGR(timer) = TIM_EGR_UG; /* takes over the prescaler */
    TIM_SR(timer) = 0;
}

/* Memory keeps the count through a reset, noise of the converter differs after a loss of power. */
static uint32_t boot_id(void)
{
    uint32_t noise = 0, turn;
    for (turn = 0; turn < 64; turn++) {
        noise = (noise << 5 | noise >> 27) ^ tt_board_convert();
    }
    return ++boots ^ noise << 8;
}

int main(void)
{
    struct tt_facts own = facts;
    bool exact = start_clocks(), told = false;
    start_pins();
    start_converter();
    start_timer(TIM5, TIMER_CLOCK / 1000000u, 0u);
    own.boot = boot_id();
    tt_device_init(&device, &own);
    USART2_BRR = LINE_DIVIDER;
    USART2_CR1 = USART_CR1_OVER8 | USART_CR1_UE | USART_CR1_TE | USART_CR1_RE | USART_CR1_RXNEIE;
    TIM_DIER(TIM2) = TIM_DIER_UIE;
    start_timer(TIM2, 1u, TIMER_CLOCK / 1000000u * TICK_US);
    NVIC_PRIORITY(IRQ_TIM2, 0);
    NVIC_PRIORITY(IRQ_USART2, 4);
#ifndef EMULATED
    NVIC_ENABLE(IRQ_TIM2);
    NVIC_ENABLE(IRQ_USART2);
#endif
    IWDG_KR = IWDG_UNLOCK;
    IWDG_PR = 3u; /* 32 kHz / 32: a ms each */
    IWDG_RLR = WATCHDOG_MS;
    IWDG_KR = IWDG_START;
    for (;;) {
        IWDG_KR = IWDG_FEED;
        (void)tt_device_poll(&device);
        if (device.scan.running && !exact && !told)
            tt_device_fault(&device, "no clock from outside: 1 % off");
        told = device.scan.running;
#ifdef EMULATED
        usart();
        tick();
#endif
    }
}
