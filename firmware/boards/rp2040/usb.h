/* A serial line over USB (CDC ACM): the queues of a device on one side, the host on the other. */
#ifndef USB_H
#define USB_H

#include "tt_queue.h"

/* Show the device to the host; strings have at most 32 characters of ASCII. Main, once. */
void usb_start(struct tt_queue *received, struct tt_queue *sent, const char *product,
               const char *serial);

/* There may be something to send, or room for what is received. Main loop. */
void usb_wake(void);

/* The vector of IRQ_USB. */
void usb_interrupt(void);

#endif
