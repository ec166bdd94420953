/* What a Cortex-M does before main: memory, vectors, and an end for every surprise.
 *
 * The linker script of the board gives the symbols; the board gives `main` and its vectors in
 * the section .irq_vectors.
 */
#include <stdint.h>
#include <string.h>

extern uint32_t link_stack_top, link_data_load, link_data, link_data_end, link_bss, link_bss_end;
int main(void);

void reset_handler(void);
void fault_handler(void);

/* The sixteen vectors of the core; the linker script puts those of the board behind them. */
struct vectors {
    uint32_t *stack_top;
    void (*handlers[15])(void);
};

__attribute__((section(".vectors"), used)) static const struct vectors core_vectors = {
    &link_stack_top,
    {
        reset_handler, fault_handler, fault_handler, fault_handler, fault_handler, fault_handler,
        0, 0, 0, 0, fault_handler, fault_handler, 0, fault_handler, fault_handler,
    },
};

/* A fault resets: the host sees another boot id. AIRCR, SYSRESETREQ with its key. */
void fault_handler(void)
{
    *(volatile uint32_t *)0xE000ED0Cu = 0x05FA0004u;
    for (;;) {
    }
}

void reset_handler(void)
{
#ifdef __ARM_FP
    *(volatile uint32_t *)0xE000ED88u |= 0xFu << 20; /* CPACR: the unit that the compiler uses */
#endif
    uintptr_t data = (uintptr_t)&link_data, bss = (uintptr_t)&link_bss;
    if (&link_data_load != &link_data)
        memcpy(&link_data, &link_data_load, (uintptr_t)&link_data_end - data);
    memset(&link_bss, 0, (uintptr_t)&link_bss_end - bss);
    (void)main();
    fault_handler();
}
