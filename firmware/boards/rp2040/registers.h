/* Registers of the RP2040 that this board uses (RP2040 datasheet; section numbers behind each). */
#ifndef REGISTERS_H
#define REGISTERS_H

#include "core.h"

/* Peripherals have a second and third address each, at which bits are set or cleared (2.1.2) */
#define SET_BITS(address) REGISTER((address) + 0x2000u)
#define CLEAR_BITS(address) REGISTER((address) + 0x3000u)

/* Resets (2.14) */
#define RESETS 0x4000C000u
#define RESETS_DONE REGISTER(RESETS + 8u)
#define RESET_ADC (1u << 0)
#define RESET_IO (1u << 5)
#define RESET_PADS (1u << 8)
#define RESET_PLL_SYS (1u << 12)
#define RESET_PLL_USB (1u << 13)
#define RESET_PWM (1u << 14)
#define RESET_TIMER (1u << 21)
#define RESET_USB (1u << 24)

/* Crystal, of 12 MHz (2.16) */
#define XOSC_CTRL REGISTER(0x40024000u)
#define XOSC_STATUS REGISTER(0x40024004u)
#define XOSC_STARTUP REGISTER(0x4002400Cu)
#define XOSC_CTRL_ON (0xFABu << 12 | 0xAA0u)
#define XOSC_STATUS_STABLE (1u << 31)
#define XOSC_STARTUP_4_MS (188u) /* times 256 cycles */

/* PLLs (2.18) */
#define PLL_SYS 0x40028000u
#define PLL_USB 0x4002C000u
#define PLL_CS(pll) REGISTER((pll) + 0x0u)
#define PLL_PWR (0x4u)
#define PLL_FBDIV(pll) REGISTER((pll) + 0x8u)
#define PLL_PRIM(pll) REGISTER((pll) + 0xCu)
#define PLL_CS_LOCK (1u << 31)
#define PLL_PWR_OFF (1u << 0 | 1u << 5)
#define PLL_PWR_DIVIDERS_OFF (1u << 3)

/* Clocks (2.15) */
#define CLK_REF_CTRL REGISTER(0x40008030u)
#define CLK_REF_SELECTED REGISTER(0x40008038u)
#define CLK_SYS_CTRL REGISTER(0x4000803Cu)
#define CLK_SYS_SELECTED REGISTER(0x40008044u)
#define CLK_USB_CTRL REGISTER(0x40008054u)
#define CLK_ADC_CTRL REGISTER(0x40008060u)
#define CLK_REF_XOSC 2u
#define CLK_SYS_PLL 1u
#define CLK_ENABLE_PLL_USB (1u << 11)

/* Watchdog, and the µs of the timer (4.7) */
#define WATCHDOG 0x40058000u
#define WATCHDOG_CTRL REGISTER(WATCHDOG)
#define WATCHDOG_LOAD REGISTER(WATCHDOG + 0x4u)
#define WATCHDOG_SCRATCH0 REGISTER(WATCHDOG + 0xCu)
#define WATCHDOG_TICK REGISTER(WATCHDOG + 0x2Cu)
#define WATCHDOG_CTRL_ENABLE (1u << 30)
#define WATCHDOG_TICK_12_MHZ (1u << 9 | 12u)
#define PSM_WDSEL REGISTER(0x40010008u)
#define PSM_ALL_BUT_OSCILLATORS 0x1FFFCu

/* Random bits of the ring oscillator (2.17) */
#define ROSC_RANDOMBIT REGISTER(0x4006001Cu)

/* Timer of 64 bits, µs (4.6) */
#define TIMER_RAWH REGISTER(0x40054024u)
#define TIMER_RAWL REGISTER(0x40054028u)

/* PWM slice 0, as a periodic timer (4.5) */
#define PWM0_CSR REGISTER(0x40050000u)
#define PWM0_TOP REGISTER(0x40050010u)
#define PWM_INTR REGISTER(0x400500A4u)
#define PWM_INTE REGISTER(0x400500A8u)
#define PWM0 1u

/* Pins (2.19, 2.3.1.7) */
#define IO_CTRL(pin) REGISTER(0x40014004u + 8u * (pin))
#define IO_CTRL_SIO 5u
#define PAD(pin) REGISTER(0x4001C004u + 4u * (pin))
#define PAD_ANALOG (1u << 7) /* no output, no input, no resistors */
#define SIO_OUT REGISTER(0xD0000010u)
#define SIO_OUT_SET REGISTER(0xD0000014u)
#define SIO_OUT_CLEAR REGISTER(0xD0000018u)
#define SIO_OUT_XOR REGISTER(0xD000001Cu)
#define SIO_OE_SET REGISTER(0xD0000024u)

/* Converter (4.9) */
#define ADC_CS REGISTER(0x4004C000u)
#define ADC_RESULT REGISTER(0x4004C004u)
#define ADC_CS_ENABLE (1u << 0)
#define ADC_CS_START (1u << 2)
#define ADC_CS_READY (1u << 8)
#define ADC_CS_ERROR (1u << 9)

/* USB controller and its memory (4.1) */
#define USB_MEMORY 0x50100000u
#define USB 0x50110000u
#define USB_ADDRESS REGISTER(USB)
#define USB_MAIN_CTRL REGISTER(USB + 0x40u)
#define USB_SIE_CTRL REGISTER(USB + 0x4Cu)
#define USB_SIE_STATUS REGISTER(USB + 0x50u)
#define USB_BUFF_STATUS REGISTER(USB + 0x58u)
#define USB_STALL_ARM REGISTER(USB + 0x68u)
#define USB_MUXING REGISTER(USB + 0x74u)
#define USB_POWER REGISTER(USB + 0x78u)
#define USB_INTE REGISTER(USB + 0x90u)
#define USB_MAIN_ENABLE 1u
#define USB_SIE_EP0_INTERRUPTS (1u << 29)
#define USB_SIE_PULLUP (1u << 16)
#define USB_SIE_SETUP (1u << 17)
#define USB_SIE_BUS_RESET (1u << 19)
#define USB_MUXING_PHY (1u << 0 | 1u << 3)
#define USB_POWER_VBUS (1u << 2 | 1u << 3) /* taken for there */
#define USB_INTE_BUFFER (1u << 4)
#define USB_INTE_BUS_RESET (1u << 12)
#define USB_INTE_SETUP (1u << 16)

/* Flash, as memory (4.10) */
#define SSI_CTRLR0 REGISTER(0x18000000u)
#define SSI_CTRLR1 REGISTER(0x18000004u)
#define SSI_SSIENR REGISTER(0x18000008u)
#define SSI_BAUDR REGISTER(0x18000014u)
#define SSI_SPI_CTRLR0 REGISTER(0x180000F4u)
#define VTOR REGISTER(0xE000ED08u)

enum { IRQ_PWM = 4, IRQ_USB = 5, IRQS = 32 };

/* A Cortex-M0+ takes words alone here: PWM before all others, USB behind them */
#define NVIC_IPR1 REGISTER(0xE000E404u)
#define NVIC_PWM_FIRST 0x0000C000u

#endif
