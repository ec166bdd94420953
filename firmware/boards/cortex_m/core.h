/* Registers of every Cortex-M core: interrupts. ARMv7-M Architecture Reference Manual, B1 and B3. */
#ifndef CORE_H
#define CORE_H

#include <stdint.h>

#define REGISTER(address) (*(volatile uint32_t *)(address))

#define NVIC_ENABLE(irq) (REGISTER(0xE000E100u + 4u * ((irq) / 32u)) = 1u << ((irq) % 32u))
#define NVIC_PEND(irq) (REGISTER(0xE000E200u + 4u * ((irq) / 32u)) = 1u << ((irq) % 32u))
#define NVIC_PRIORITY(irq, level) \
    (*(volatile uint8_t *)(0xE000E400u + (irq)) = (uint8_t)((level) << 4))

static inline uint32_t interrupts_off(void)
{
    uint32_t before;
    __asm__ volatile("mrs %0, primask\n\tcpsid i" : "=r"(before) : : "memory");
    return before;
}

static inline void interrupts_restore(uint32_t before)
{
    __asm__ volatile("msr primask, %0" : : "r"(before) : "memory");
}

#endif
