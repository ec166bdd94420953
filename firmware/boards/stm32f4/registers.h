/* Registers of the STM32F405 and the STM32F446 that this board uses; both have them at the same
 * places (ST's reference manuals RM0090 and RM0390). */
#ifndef REGISTERS_H
#define REGISTERS_H

#include "core.h"

/* Clocks */
#define RCC_CR REGISTER(0x40023800u)
#define RCC_PLLCFGR REGISTER(0x40023804u)
#define RCC_CFGR REGISTER(0x40023808u)
#define RCC_AHB1ENR REGISTER(0x40023830u)
#define RCC_APB1ENR REGISTER(0x40023840u)
#define RCC_APB2ENR REGISTER(0x40023844u)
#define RCC_CR_HSEON (1u << 16)
#define RCC_CR_HSERDY (1u << 17)
#define RCC_CR_HSEBYP (1u << 18)
#define RCC_CR_PLLON (1u << 24)
#define RCC_CR_PLLRDY (1u << 25)
#define RCC_PLLCFGR_HSE (1u << 22)
#define RCC_PLLCFGR_N168_P2_Q7_R2 (168u << 6 | 7u << 24 | 2u << 28)
#define RCC_CFGR_SW_PLL 2u
#define RCC_CFGR_SWS (3u << 2)
#define RCC_CFGR_SWS_PLL (2u << 2)
#define RCC_CFGR_PPRE1_4 (5u << 10)
#define RCC_CFGR_PPRE2_2 (4u << 13)
#define RCC_AHB1ENR_GPIOA (1u << 0)
#define RCC_AHB1ENR_GPIOC (1u << 2)
#define RCC_APB1ENR_TIM2 (1u << 0)
#define RCC_APB1ENR_TIM5 (1u << 3)
#define RCC_APB1ENR_USART2 (1u << 17)
#define RCC_APB2ENR_ADC1 (1u << 8)
#define FLASH_ACR REGISTER(0x40023C00u)
#define FLASH_ACR_5_WAITS_AND_CACHES (5u | 1u << 8 | 1u << 9 | 1u << 10)

/* Pins: two bits of mode each (0 input, 1 output, 2 alternate, 3 analog) */
#define GPIOA 0x40020000u
#define GPIOC 0x40020800u
#define GPIO_MODER(port) REGISTER((port) + 0x00u)
#define GPIO_OSPEEDR(port) REGISTER((port) + 0x08u)
#define GPIO_PUPDR(port) REGISTER((port) + 0x0Cu)
#define GPIO_BSRR(port) REGISTER((port) + 0x18u)
#define GPIO_AFRL(port) REGISTER((port) + 0x20u)

/* Timers; TIM2 and TIM5 have 32 bits */
#define TIM2 0x40000000u
#define TIM5 0x40000C00u
#define TIM_CR1(timer) REGISTER((timer) + 0x00u)
#define TIM_DIER(timer) REGISTER((timer) + 0x0Cu)
#define TIM_SR(timer) REGISTER((timer) + 0x10u)
#define TIM_EGR(timer) REGISTER((timer) + 0x14u)
#define TIM_CNT(timer) REGISTER((timer) + 0x24u)
#define TIM_PSC(timer) REGISTER((timer) + 0x28u)
#define TIM_ARR(timer) REGISTER((timer) + 0x2Cu)
#define TIM_CR1_CEN 1u
#define TIM_DIER_UIE 1u
#define TIM_EGR_UG 1u

/* Converter */
#define ADC1_SR REGISTER(0x40012000u)
#define ADC1_CR1 REGISTER(0x40012004u)
#define ADC1_CR2 REGISTER(0x40012008u)
#define ADC1_SMPR2 REGISTER(0x40012010u)
#define ADC1_SQR1 REGISTER(0x4001202Cu)
#define ADC1_SQR3 REGISTER(0x40012034u)
#define ADC1_DR REGISTER(0x4001204Cu)
#define ADC_CCR REGISTER(0x40012304u)
#define ADC_SR_EOC (1u << 1)
#define ADC_CR2_ADON 1u
#define ADC_CR2_SWSTART (1u << 30)
#define ADC_CCR_CLOCK_4 (1u << 16)
#define ADC_SMPR2_28_CYCLES 2u

/* Serial line */
#define USART2_SR REGISTER(0x40004400u)
#define USART2_DR REGISTER(0x40004404u)
#define USART2_BRR REGISTER(0x40004408u)
#define USART2_CR1 REGISTER(0x4000440Cu)
#define USART_SR_ORE (1u << 3)
#define USART_SR_RXNE (1u << 5)
#define USART_SR_TXE (1u << 7)
#define USART_CR1_RE (1u << 2)
#define USART_CR1_TE (1u << 3)
#define USART_CR1_RXNEIE (1u << 5)
#define USART_CR1_TXEIE (1u << 7)
#define USART_CR1_UE (1u << 13)
#define USART_CR1_OVER8 (1u << 15)

/* Watchdog, of a clock of its own (32 kHz) */
#define IWDG_KR REGISTER(0x40003000u)
#define IWDG_PR REGISTER(0x40003004u)
#define IWDG_RLR REGISTER(0x40003008u)
#define IWDG_UNLOCK 0x5555u
#define IWDG_START 0xCCCCu
#define IWDG_FEED 0xAAAAu

enum { IRQ_TIM2 = 28, IRQ_USART2 = 38, IRQS = 48 };

#endif
