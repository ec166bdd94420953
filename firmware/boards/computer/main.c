/* A computer as a board: the line is standard input and output. For tests and first trials.
 *
 * A reading tells its row and electrode. The timer is the loop itself, which sleeps for TICK_US.
 */
#define _POSIX_C_SOURCE 200809L
#include <fcntl.h>
#include <math.h>
#include <stdlib.h>
#include <sys/select.h>
#include <time.h>
#include <unistd.h>

#include "tt_board.h"
#include "tt_device.h"

enum { ELECTRODES = 6, TICK_US = 100 };

static struct tt_device device;
static uint16_t grounded, selected;

uint64_t tt_board_time(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u;
}

void tt_board_lock(void)
{
}

void tt_board_unlock(void)
{
}

void tt_board_ground(uint16_t electrode)
{
    grounded = electrode;
}

void tt_board_select(uint16_t electrode)
{
    selected = electrode;
}

uint32_t tt_board_convert(void)
{
    return 100u * grounded + selected;
}

float tt_board_temperature(void)
{
    return 21.5f;
}

void tt_board_send(void)
{
}

/* As much as the line takes without waiting. */
static void send(void)
{
    const uint8_t *data;
    uint16_t length = tt_queue_piece(&device.sending, &data);
    ssize_t sent = length > 0 ? write(STDOUT_FILENO, data, length) : 0;
    if (sent > 0)
        tt_queue_drop(&device.sending, (uint16_t)sent);
}

/* False at the end of the input. */
static int receive(void)
{
    uint8_t bytes[TT_RECEIVE_BYTES];
    uint16_t room = tt_queue_room(&device.received);
    ssize_t length = read(STDIN_FILENO, bytes, room);
    if (length > 0)
        (void)tt_queue_put(&device.received, bytes, (size_t)length);
    return length > 0;
}

/* Wait for input or for the next tick; whether there is input. */
static int wait(void)
{
    struct timeval tick = {0, TICK_US};
    fd_set inputs;
    FD_ZERO(&inputs);
    FD_SET(STDIN_FILENO, &inputs);
    return select(STDIN_FILENO + 1, &inputs, NULL, NULL, &tick) > 0;
}

int main(int argc, char **argv)
{
    struct tt_facts facts = {
        ELECTRODES, 1, 1, 1.0f / (200.0f * ELECTRODES * 7.0f), 12, 0, 3.3f / 4096.0f, 3.3f, 20.0f,
        0, 0, 0, "example", "2.0.0", "C1",
    };
    facts.address = (uint8_t)(argc > 1 ? atoi(argv[1]) : 0);
    facts.boot = (uint32_t)tt_board_time() ^ (uint32_t)getpid();
    fcntl(STDOUT_FILENO, F_SETFL, fcntl(STDOUT_FILENO, F_GETFL) | O_NONBLOCK);
    tt_device_init(&device, &facts);
    for (;;) {
        if (wait() && !receive())
            return 0;
        do {
            while (tt_scan_tick(&device.scan)) {
            }
        } while (tt_device_poll(&device));
        send();
    }
}
