/* The scan: which electrode is grounded and which one is read, at which tick of a timer.
 *
 * A board calls `tt_scan_tick` from a timer interrupt. A row begins at the first tick at or behind
 * its time: its electrode is grounded, and each reading is taken after a whole number of ticks, so
 * that multiplexer and sheet settle for a time that no software delays. Finished rows wait in a
 * short queue for the main loop. Where that is full the row is dropped and counted; the scan never
 * waits. There is no division in here, and nothing of 64 bits but additions and comparisons.
 */
#ifndef TT_SCAN_H
#define TT_SCAN_H

#include <stdbool.h>
#include <stdint.h>

#include "tt_config.h"

/* Times of the schedule are in 1/65536 µs: rows keep a rate that is no whole number of µs. */
#define TT_FRACTION_BITS 16

struct tt_row {
    uint64_t frame_time; /* µs, begin of the frame's first row */
    uint32_t row_end;    /* µs behind it, this row's last conversion */
    uint32_t sequence;
    uint16_t row, rows, grounded, scan;
    uint16_t readings[TT_MAX_ELECTRODES];
};

/* What holds for whole frames. */
struct tt_plan {
    uint64_t period; /* from row to row, 1/65536 µs */
    float rate;      /* frames/s, as the host is told */
    uint16_t scan;   /* tag of the command that gave the order, 0: own order */
    uint16_t rows;
    uint16_t order[TT_MAX_ROWS];
};

struct tt_scan {
    uint16_t electrodes;
    uint16_t settle_ground, settle_read; /* ticks, 1 or more */
    struct tt_plan plans[2];
    volatile uint8_t active;      /* the plan of the frame under way */
    volatile bool changed;        /* the other plan holds from the next frame on */
    volatile bool running;        /* rows are begun */
    volatile bool in_row;         /* a row is being taken */
    volatile uint16_t next_row;   /* of the frame under way */
    volatile uint32_t sequence;   /* of the frame under way, or of the next one if none is */
    volatile uint32_t frames_left; /* 0: no end */
    volatile uint32_t overruns;   /* rows that found the queue full */
    uint64_t due, frame_time;
    uint16_t wait, electrode;
    struct tt_row rows[TT_ROWS_WAITING];
    volatile uint8_t rows_in, rows_out;
};

/* Before anything else; the own order grounds each electrode in turn. */
void tt_scan_init(struct tt_scan *scan, uint16_t electrodes, uint16_t settle_ground,
                  uint16_t settle_read);

/* Timer interrupt. Returns whether a row is under way. */
bool tt_scan_tick(struct tt_scan *scan);

/* Main loop: begin a new frame; the scan must have stopped. `frames`: stop behind so many, 0: go on. */
void tt_scan_start(struct tt_scan *scan, uint32_t frames);

/* Main loop: a scan that runs goes on for so many frames from now, 0: without end; false where it
 * has ended. */
bool tt_scan_renew(struct tt_scan *scan, uint32_t frames);

/* Main loop: stop behind the row under way; false until that is over. */
bool tt_scan_stop(struct tt_scan *scan);

/* Main loop: a plan to fill in, which begins as the last one, and the way to put it into effect. */
struct tt_plan *tt_scan_change(struct tt_scan *scan);
void tt_scan_commit(struct tt_scan *scan);
const struct tt_plan *tt_scan_last_plan(const struct tt_scan *scan);

/* Main loop: sequence number of the next frame that begins. */
uint32_t tt_scan_next_sequence(const struct tt_scan *scan);

/* Main loop: the oldest finished row, or NULL; it stays valid until `tt_scan_release`. */
const struct tt_row *tt_scan_finished(const struct tt_scan *scan);
void tt_scan_release(struct tt_scan *scan);

#endif
