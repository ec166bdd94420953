/* The first 256 bytes of the flash: the chip's ROM copies them to memory and calls them there (if
 * their checksum is right, see make_uf2.py). They make the flash readable as memory and go on to
 * the vectors behind them. The slow read command 03h is what every flash knows.
 */
#include "registers.h"

#define VECTORS 0x10000100u

__attribute__((section(".boot2"), used, noreturn)) static void boot2(void)
{
    SSI_SSIENR = 0;
    SSI_BAUDR = 4;                        /* 125 MHz / 4 */
    SSI_CTRLR0 = 3u << 8 | 31u << 16;     /* read like an EEPROM, words of 32 bits */
    SSI_CTRLR1 = 0;                       /* one at a time */
    SSI_SPI_CTRLR0 = 0x03u << 24 | 2u << 8 | 6u << 2; /* command of 8 bits, address of 24 */
    SSI_SSIENR = 1;
    VTOR = VECTORS;
    __asm__ volatile("ldr r0, [%0]\n\tmsr msp, r0\n\tldr r0, [%0, #4]\n\tbx r0"
                     : : "l"(VECTORS) : "r0", "memory");
    __builtin_unreachable();
}
