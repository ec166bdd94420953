/* See tt_scan.h. */
#include "tt_scan.h"

#include <string.h>

#include "tt_board.h"
#include "tt_messages.h"

/* Counters of 8 bits that wrap around must do so at a whole number of slots. */
typedef char tt_slots_divide_256[256 % TT_ROWS_WAITING == 0 ? 1 : -1];

static uint64_t now_in_fractions(void)
{
    return tt_board_time() << TT_FRACTION_BITS;
}

void tt_scan_init(struct tt_scan *scan, uint16_t electrodes, uint16_t settle_ground,
                  uint16_t settle_read)
{
    struct tt_plan *plan = &scan->plans[0];
    uint16_t row;
    memset(scan, 0, sizeof *scan);
    scan->electrodes = electrodes;
    scan->settle_ground = settle_ground > 0 ? settle_ground : 1;
    scan->settle_read = settle_read > 0 ? settle_read : 1;
    plan->rows = electrodes;
    for (row = 0; row < electrodes; row++)
        plan->order[row] = row;
}

/* Interrupt: the slot of the row to be taken next, NULL where all are full. */
static struct tt_row *free_slot(struct tt_scan *scan)
{
    uint8_t waiting = (uint8_t)(scan->rows_in - scan->rows_out);
    return waiting < TT_ROWS_WAITING ? &scan->rows[scan->rows_in % TT_ROWS_WAITING] : NULL;
}

/* A scan that is late catches up, by rows that follow one another at once, but for no more than this;
 * then, as after a stop in a debugger, its schedule begins anew: the times tell. */
#define LATEST ((uint64_t)100000u << TT_FRACTION_BITS)

/* Interrupt: the frame that begins follows the plan that was committed last. */
static void begin_frame(struct tt_scan *scan, uint64_t now)
{
    if (scan->changed) {
        scan->active ^= 1u;
        scan->changed = false;
    }
    if (now - scan->due > LATEST)
        scan->due = now;
    scan->frame_time = now >> TT_FRACTION_BITS;
}

/* Interrupt: behind a row, taken or dropped. */
static void end_row(struct tt_scan *scan)
{
    const struct tt_plan *plan = &scan->plans[scan->active];
    scan->in_row = false;
    scan->due += plan->period;
    scan->next_row++;
    if (scan->next_row < plan->rows)
        return;
    scan->next_row = 0;
    scan->sequence++;
    if (scan->frames_left > 0 && --scan->frames_left == 0)
        scan->running = false;
}

static void begin_row(struct tt_scan *scan, uint64_t now)
{
    const struct tt_plan *plan;
    struct tt_row *slot = free_slot(scan);
    if (scan->next_row == 0)
        begin_frame(scan, now);
    plan = &scan->plans[scan->active];
    if (slot == NULL) {
        scan->overruns++;
        end_row(scan);
        return;
    }
    slot->frame_time = scan->frame_time;
    slot->sequence = scan->sequence;
    slot->row = scan->next_row;
    slot->rows = plan->rows;
    slot->scan = plan->scan;
    slot->grounded = plan->order[scan->next_row];
    tt_board_ground(slot->grounded);
    tt_board_select(0);
    scan->electrode = 0;
    scan->wait = scan->settle_ground;
    scan->in_row = true;
}

static uint16_t sent_as(uint32_t counts)
{
    if (counts == TT_NONE)
        return TT_NO_READING;
    return (uint16_t)(counts < TT_HIGHEST_READING ? counts : TT_HIGHEST_READING);
}

bool tt_scan_tick(struct tt_scan *scan)
{
    struct tt_row *slot;
    uint32_t reading;
    if (!scan->in_row) {
        uint64_t now;
        if (!scan->running)
            return false;
        now = now_in_fractions();
        if (now >= scan->due)
            begin_row(scan, now);
        return scan->in_row;
    }
    if (--scan->wait > 0)
        return true;
    slot = &scan->rows[scan->rows_in % TT_ROWS_WAITING];
    reading = tt_board_convert();
    slot->readings[scan->electrode] = sent_as(reading);
    scan->electrode++;
    if (scan->electrode < scan->electrodes) {
        tt_board_select(scan->electrode);
        scan->wait = scan->settle_read;
        return true;
    }
    slot->row_end = (uint32_t)(tt_board_time() - scan->frame_time);
    tt_board_ground(TT_GROUND_NONE);
    TT_BARRIER();
    scan->rows_in++;
    end_row(scan);
    return false;
}

void tt_scan_start(struct tt_scan *scan, uint32_t frames)
{
    scan->next_row = 0;
    scan->frames_left = frames;
    scan->due = now_in_fractions();
    TT_BARRIER();
    scan->running = true;
}

bool tt_scan_renew(struct tt_scan *scan, uint32_t frames)
{
    bool running;
    tt_board_lock(); /* or the last frame ends between question and answer */
    running = scan->running;
    if (running)
        scan->frames_left = frames;
    tt_board_unlock();
    return running;
}

bool tt_scan_stop(struct tt_scan *scan)
{
    scan->running = false;
    TT_BARRIER();
    if (scan->in_row)
        return false;
    if (scan->next_row > 0) {
        scan->next_row = 0;
        scan->sequence++;
    }
    return true;
}

const struct tt_plan *tt_scan_last_plan(const struct tt_scan *scan)
{
    return &scan->plans[scan->changed ? scan->active ^ 1u : scan->active];
}

struct tt_plan *tt_scan_change(struct tt_scan *scan)
{
    bool pending;
    tt_board_lock();
    pending = scan->changed;
    scan->changed = false;
    tt_board_unlock();
    if (!pending)
        scan->plans[scan->active ^ 1u] = scan->plans[scan->active];
    return &scan->plans[scan->active ^ 1u];
}

void tt_scan_commit(struct tt_scan *scan)
{
    TT_BARRIER();
    scan->changed = true;
}

uint32_t tt_scan_next_sequence(const struct tt_scan *scan)
{
    uint32_t sequence;
    tt_board_lock();
    sequence = scan->sequence + (scan->next_row > 0 || scan->in_row ? 1u : 0u);
    tt_board_unlock();
    return sequence;
}

const struct tt_row *tt_scan_finished(const struct tt_scan *scan)
{
    if (scan->rows_in == scan->rows_out)
        return NULL;
    TT_BARRIER();
    return &scan->rows[scan->rows_out % TT_ROWS_WAITING];
}

void tt_scan_release(struct tt_scan *scan)
{
    TT_BARRIER();
    scan->rows_out++;
}
