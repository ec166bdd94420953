/* Sizes of all memory that the library uses; it allocates none. A board may define others. */
#ifndef TT_CONFIG_H
#define TT_CONFIG_H

#ifndef TT_MAX_ELECTRODES
#define TT_MAX_ELECTRODES 64
#endif

/* Longest order of grounded electrodes that a host may command. */
#ifndef TT_MAX_ROWS
#define TT_MAX_ROWS TT_MAX_ELECTRODES
#endif

/* Rows that may wait between the interrupt that takes them and the main loop that sends them. */
#ifndef TT_ROWS_WAITING
#define TT_ROWS_WAITING 4
#endif

/* Bytes that may wait for the line, a power of two. What waits here is old: at 2 Mbit/s 8192 bytes
 * take 41 ms. */
#ifndef TT_SEND_BYTES
#define TT_SEND_BYTES 8192
#endif

/* Bytes of commands that may wait for the main loop, a power of two. */
#ifndef TT_RECEIVE_BYTES
#define TT_RECEIVE_BYTES 256
#endif

#endif
