/* See tt_device.h; the rules are those of docs/protocol.md, sections 2 to 4. */
#include "tt_device.h"

#include <string.h>

#include "tt_board.h"

/* Room that rows leave to answers, so that a slow line delays them but does not swallow them. */
#define ANSWER_ROOM (2u * TT_WIRE_SIZE(TT_LONGEST_ANSWER))

/* row_end holds 4294 s: a frame must not take longer. */
#define LONGEST_FRAME 1000.0f /* s */

#define US_PER_S 1e6f
#define FRACTIONS 65536.0f
#define ROUNDING 1.000001f /* of the fastest rate, which the host gives back in frames/s */

struct command {
    uint8_t type, version;
    uint16_t tag;
    bool answered; /* not where it is for all on the bus */
    const uint8_t *bytes;
    size_t length;
};

static float clamped(float value, float low, float high)
{
    return value < low ? low : value > high ? high : value;
}

/* Frames/s from now on, for as many rows as the plan has. */
static void apply_rate(struct tt_plan *plan, float rate)
{
    plan->rate = rate;
    plan->period = (uint64_t)(US_PER_S * FRACTIONS / (rate * (float)plan->rows));
}

/* Rows of a frame and its rate as a host of that version sees them: version 1 knows but the own
 * order, which its START puts back. */
static float rows_for(const struct tt_device *device, uint8_t version)
{
    return version == 1 ? (float)device->facts->electrodes
                        : (float)tt_scan_last_plan(&device->scan)->rows;
}

static float rate_for(const struct tt_device *device, uint8_t version)
{
    const struct tt_plan *plan = tt_scan_last_plan(&device->scan);
    float rows = rows_for(device, version);
    return rows == (float)plan->rows ? plan->rate : plan->rate * (float)plan->rows / rows;
}

void tt_device_init(struct tt_device *device, const struct tt_facts *facts)
{
    float ticks, rate;
    memset(device, 0, sizeof *device);
    device->facts = facts;
    device->received.bytes = device->received_bytes;
    device->received.size = TT_RECEIVE_BYTES;
    device->sending.bytes = device->sending_bytes;
    device->sending.size = TT_SEND_BYTES;
    tt_scan_init(&device->scan, facts->electrodes, facts->settle_ground, facts->settle_read);
    ticks = (float)device->scan.settle_ground + 1.0f
        + (float)(facts->electrodes - 1u) * (float)device->scan.settle_read;
    device->fastest_row_rate = 1.0f / (ticks * facts->tick);
    if (facts->line_rate > 0) {
        size_t packet = TT_V2_ROW_SIZE + 2u * facts->electrodes + TT_CRC_SIZE;
        float on_line = (float)facts->line_rate / (10.0f * (float)TT_WIRE_SIZE(packet));
        device->fastest_row_rate = clamped(device->fastest_row_rate, 0.0f, on_line);
    }
    rate = device->fastest_row_rate / (float)facts->electrodes;
    apply_rate(&device->scan.plans[0], clamped(facts->rate, 1.0f / LONGEST_FRAME, rate));
    (void)tt_queue_put(&device->sending, (const uint8_t *)"", 1); /* against noise at power-up */
}

/* Close the packet and put it into the queue, where `room` bytes stay free behind it. */
static bool send_packet(struct tt_device *device, size_t length, uint16_t room)
{
    length = tt_put_u32(device->packet, length, tt_crc32(device->packet, length));
    length = tt_cobs_encode(device->packet, length, device->wire);
    if (tt_queue_room(&device->sending) < length + room)
        return false;
    (void)tt_queue_put(&device->sending, device->wire, length);
    tt_board_send();
    return true;
}

/* ---- rows ------------------------------------------------------------------------------------ */

static size_t row_head_1(struct tt_device *device, const struct tt_row *row)
{
    const struct tt_facts *facts = device->facts;
    uint8_t *packet = device->packet;
    (void)tt_put_u16(packet, TT_V1_ROW_COUNT, facts->electrodes);
    (void)tt_put_u16(packet, TT_V1_ROW_ROW, row->row);
    (void)tt_put_u16(packet, TT_V1_ROW_ROWS, row->rows);
    (void)tt_put_u32(packet, TT_V1_ROW_SEQUENCE, row->sequence);
    (void)tt_put_u32(packet, TT_V1_ROW_ROW_END, row->row_end);
    (void)tt_put_u64(packet, TT_V1_ROW_FRAME_TIME, row->frame_time);
    (void)tt_put_f32(packet, TT_V1_ROW_SCALE, facts->scale);
    (void)tt_put_f32(packet, TT_V1_ROW_DRIVE_VOLTAGE, facts->drive_voltage);
    (void)tt_put_u16(packet, TT_V1_ROW_GROUNDED, row->grounded);
    return TT_V1_ROW_SIZE;
}

static size_t row_head_2(struct tt_device *device, const struct tt_row *row)
{
    const struct tt_facts *facts = device->facts;
    uint8_t *packet = device->packet;
    memset(packet, 0, TT_V2_ROW_SIZE);
    (void)tt_put_u16(packet, TT_V2_ROW_SCAN, row->scan);
    (void)tt_put_u16(packet, TT_V2_ROW_ROW, row->row);
    (void)tt_put_u8(packet, TT_V2_ROW_ADDRESS, facts->address);
    (void)tt_put_u32(packet, TT_V2_ROW_SEQUENCE, row->sequence);
    (void)tt_put_u32(packet, TT_V2_ROW_ROW_END, row->row_end);
    (void)tt_put_u64(packet, TT_V2_ROW_FRAME_TIME, row->frame_time);
    (void)tt_put_f32(packet, TT_V2_ROW_SCALE, facts->scale);
    (void)tt_put_f32(packet, TT_V2_ROW_DRIVE_VOLTAGE, facts->drive_voltage);
    (void)tt_put_u16(packet, TT_V2_ROW_COUNT, facts->electrodes);
    (void)tt_put_u16(packet, TT_V2_ROW_ROWS, row->rows);
    (void)tt_put_u16(packet, TT_V2_ROW_GROUNDED, row->grounded);
    (void)tt_put_u16(packet, TT_V2_ROW_ZERO, facts->zero);
    return TT_V2_ROW_SIZE;
}

/* Version 1 knows neither the grounded electrode's own reading nor voltages below 0. */
static uint16_t reading_1(const struct tt_device *device, const struct tt_row *row, uint16_t at)
{
    uint16_t reading = row->readings[at], zero = device->facts->zero;
    if (at == row->grounded || reading == TT_NO_READING)
        return TT_NO_READING;
    return reading > zero ? (uint16_t)(reading - zero) : 0;
}

static bool send_row(struct tt_device *device, const struct tt_row *row)
{
    bool first = device->stream_version == 1;
    size_t at = first ? row_head_1(device, row) : row_head_2(device, row);
    uint16_t electrode;
    (void)tt_put_u8(device->packet, 0, TT_ROW);
    (void)tt_put_u8(device->packet, 1, device->stream_version);
    for (electrode = 0; electrode < device->facts->electrodes; electrode++) {
        uint16_t reading = first ? reading_1(device, row, electrode) : row->readings[electrode];
        at = tt_put_u16(device->packet, at, (uint16_t)(0xFFFFu - reading));
    }
    return send_packet(device, at, ANSWER_ROOM);
}

/* Where the line is too slow for a row, the rest of its frame is dropped, too: whole frames use
 * what the line carries, where single rows missing in each would leave none. */
static bool send_rows(struct tt_device *device)
{
    const struct tt_row *row;
    bool any = false;
    while ((row = tt_scan_finished(&device->scan)) != NULL) {
        if (device->dropping && row->sequence != device->dropping_sequence)
            device->dropping = false;
        if (device->dropping || !send_row(device, row)) {
            device->dropping = true;
            device->dropping_sequence = row->sequence;
            device->dropped++;
        }
        tt_scan_release(&device->scan);
        any = true;
    }
    return any;
}

/* ---- answers --------------------------------------------------------------------------------- */

static void begin_answer(struct tt_device *device, uint8_t type, const struct command *command)
{
    memset(device->packet, 0, sizeof device->packet);
    (void)tt_put_u8(device->packet, 0, type);
    (void)tt_put_u8(device->packet, 1, command->version);
    (void)tt_put_u16(device->packet, 2, command->tag);
    if (command->version > 1)
        (void)tt_put_u8(device->packet, TT_V2_ACK_ADDRESS, device->facts->address);
}

/* False where there was no room: the host will ask again. */
static bool send_answer(struct tt_device *device, const struct command *command, size_t length)
{
    return !command->answered || send_packet(device, length, 0);
}

static float full_scale(const struct tt_facts *facts)
{
    return facts->scale * ((float)((uint32_t)1 << facts->bits) - (float)facts->zero);
}

static void send_identity_1(struct tt_device *device, const struct command *command)
{
    const struct tt_facts *facts = device->facts;
    uint8_t *packet = device->packet;
    size_t at = TT_V1_IDENTITY_NAME;
    begin_answer(device, TT_IDENTITY, command);
    (void)tt_put_u16(packet, TT_V1_IDENTITY_ELECTRODES, facts->electrodes);
    (void)tt_put_u16(packet, TT_V1_IDENTITY_ROWS, facts->electrodes);
    (void)tt_put_u8(packet, TT_V1_IDENTITY_ADC_BITS, facts->bits);
    (void)tt_put_f32(packet, TT_V1_IDENTITY_RANGE, full_scale(facts));
    (void)tt_put_f32(packet, TT_V1_IDENTITY_RATE,
                     rate_for(device, 1));
    (void)tt_put_u32(packet, TT_V1_IDENTITY_LINE_RATE, facts->line_rate);
    (void)tt_put_f32(packet, TT_V1_IDENTITY_MAX_RATE, device->fastest_row_rate / (float)facts->electrodes);
    at = tt_put_string(packet, at, facts->name);
    at = tt_put_string(packet, at, facts->firmware);
    at = tt_put_string(packet, at, facts->serial);
    at = tt_put_string(packet, at, "v2"); /* version 2 is spoken, too */
    (void)send_answer(device, command, at);
}

static void send_identity_2(struct tt_device *device, const struct command *command)
{
    const struct tt_facts *facts = device->facts;
    const struct tt_plan *plan = tt_scan_last_plan(&device->scan);
    uint8_t *packet = device->packet;
    size_t at = TT_V2_IDENTITY_NAME;
    begin_answer(device, TT_IDENTITY, command);
    (void)tt_put_u16(packet, TT_V2_IDENTITY_ELECTRODES, facts->electrodes);
    (void)tt_put_u8(packet, TT_V2_IDENTITY_ADC_BITS, facts->bits);
    (void)tt_put_u16(packet, TT_V2_IDENTITY_ROWS, plan->rows);
    (void)tt_put_u16(packet, TT_V2_IDENTITY_MAX_SCAN, TT_MAX_ROWS);
    (void)tt_put_u32(packet, TT_V2_IDENTITY_BOOT, facts->boot);
    (void)tt_put_f32(packet, TT_V2_IDENTITY_LOWEST, -facts->scale * (float)facts->zero);
    (void)tt_put_f32(packet, TT_V2_IDENTITY_RANGE, full_scale(facts));
    (void)tt_put_f32(packet, TT_V2_IDENTITY_RATE, plan->rate);
    (void)tt_put_f32(packet, TT_V2_IDENTITY_MAX_ROW_RATE, device->fastest_row_rate);
    (void)tt_put_u32(packet, TT_V2_IDENTITY_LINE_RATE, facts->line_rate);
    at = tt_put_string(packet, at, facts->name);
    at = tt_put_string(packet, at, facts->firmware);
    at = tt_put_string(packet, at, facts->serial);
    (void)send_answer(device, command, at);
}

static bool send_ack(struct tt_device *device, const struct command *command, bool streaming)
{
    const struct tt_plan *plan = tt_scan_last_plan(&device->scan);
    uint8_t *packet = device->packet;
    begin_answer(device, TT_ACK, command);
    (void)tt_put_u8(packet, TT_V1_ACK_COMMAND, command->type);
    (void)tt_put_u8(packet, TT_V1_ACK_STREAMING, streaming ? 1 : 0);
    if (command->version == 1) {
        (void)tt_put_f32(packet, TT_V1_ACK_RATE, rate_for(device, 1));
        return send_answer(device, command, TT_V1_ACK_SIZE);
    }
    (void)tt_put_f32(packet, TT_V2_ACK_RATE, plan->rate);
    (void)tt_put_u32(packet, TT_V2_ACK_SEQUENCE, tt_scan_next_sequence(&device->scan));
    (void)tt_put_u16(packet, TT_V2_ACK_ROWS, plan->rows);
    return send_answer(device, command, TT_V2_ACK_SIZE);
}

static void send_error(struct tt_device *device, const struct command *command, uint8_t code,
                       const char *message)
{
    size_t at = command->version == 1 ? TT_V1_ERROR_SIZE : TT_V2_ERROR_SIZE;
    size_t length = strlen(message);
    if (length > TT_MAX_STRING)
        length = TT_MAX_STRING;
    begin_answer(device, TT_ERROR, command);
    (void)tt_put_u8(device->packet, TT_V1_ERROR_COMMAND, command->type);
    (void)tt_put_u8(device->packet, TT_V1_ERROR_CODE, code);
    memcpy(device->packet + at, message, length);
    (void)send_answer(device, command, at + length);
}

static void send_status(struct tt_device *device, const struct command *command)
{
    uint8_t *packet = device->packet;
    begin_answer(device, TT_STATUS, command);
    (void)tt_put_u8(packet, TT_V2_STATUS_STREAMING, device->scan.running ? 1 : 0);
    (void)tt_put_u32(packet, TT_V2_STATUS_BOOT, device->facts->boot);
    (void)tt_put_f32(packet, TT_V2_STATUS_TEMPERATURE, tt_board_temperature());
    (void)tt_put_u64(packet, TT_V2_STATUS_TIME, tt_board_time());
    (void)tt_put_u32(packet, TT_V2_STATUS_DROPPED, device->dropped + device->scan.overruns);
    (void)tt_put_u32(packet, TT_V2_STATUS_SEQUENCE, tt_scan_next_sequence(&device->scan));
    (void)send_answer(device, command, TT_V2_STATUS_SIZE);
}

void tt_device_fault(struct tt_device *device, const char *message)
{
    struct command none = {0, 1, 0, true, NULL, 0};
    if (device->stream_version != 0)
        none.version = device->stream_version;
    send_error(device, &none, TT_HARDWARE_FAULT, message);
}

/* ---- commands -------------------------------------------------------------------------------- */

/* False where the device cannot keep `rate`; the version is that of the command. */
static bool set_rate(struct tt_device *device, uint8_t version, float rate)
{
    float rows = rows_for(device, version);
    struct tt_plan *plan;
    if (!(rate > 0.0f && rate * rows <= device->fastest_row_rate * ROUNDING))
        return false;
    plan = tt_scan_change(&device->scan);
    if (rows != (float)plan->rows)
        rate = rate * rows / (float)plan->rows;
    apply_rate(plan, rate < 1.0f / LONGEST_FRAME ? 1.0f / LONGEST_FRAME : rate);
    tt_scan_commit(&device->scan);
    return true;
}

/* Rows from now on: `order` as it came, or each electrode in turn where `count` is 0. The time
 * from row to row stays. */
static void set_order(struct tt_device *device, uint16_t tag, uint16_t count, const uint8_t *order)
{
    struct tt_plan *plan = tt_scan_change(&device->scan);
    float row_rate = plan->rate * (float)plan->rows;
    uint16_t row;
    plan->scan = count > 0 ? tag : TT_OWN_ORDER;
    plan->rows = count > 0 ? count : device->facts->electrodes;
    for (row = 0; row < plan->rows; row++)
        plan->order[row] = count > 0 ? tt_get_u16(order + 2u * row) : row;
    plan->rate = row_rate / (float)plan->rows;
    if (plan->rate < 1.0f / LONGEST_FRAME)
        apply_rate(plan, 1.0f / LONGEST_FRAME);
    tt_scan_commit(&device->scan);
}

static bool set_scan(struct tt_device *device, const struct command *command)
{
    uint16_t count = tt_get_u16(command->bytes + TT_V2_SET_SCAN_COUNT), row;
    const uint8_t *order = command->bytes + TT_V2_SET_SCAN_SIZE;
    bool streams_1 = device->scan.running && device->stream_version == 1;
    if (count > TT_MAX_ROWS || command->length != TT_V2_SET_SCAN_SIZE + 2u * count)
        return false;
    if (command->tag == 0 || streams_1)
        return false;
    for (row = 0; row < count; row++)
        if (tt_get_u16(order + 2u * row) >= device->facts->electrodes)
            return false;
    set_order(device, command->tag, count, order);
    return true;
}

/* False where a row is under way that must end first. */
static bool start(struct tt_device *device, const struct command *command)
{
    struct tt_scan *scan = &device->scan;
    uint32_t frames = 0, timeout = 0;
    if (command->version > 1) {
        frames = tt_get_u32(command->bytes + TT_V2_START_FRAMES);
        timeout = tt_get_u16(command->bytes + TT_V2_START_TIMEOUT);
    }
    if (device->stream_version == command->version && tt_scan_renew(scan, frames)) {
        device->timeout = 1000u * timeout;
        (void)send_ack(device, command, true);
        return true;
    }
    if (!tt_scan_stop(scan))
        return false;
    (void)send_rows(device);
    device->timeout = 1000u * timeout;
    device->stream_version = command->version;
    device->dropping = false;
    if (command->version == 1 && tt_scan_last_plan(scan)->scan != TT_OWN_ORDER)
        set_order(device, 0, 0, NULL);
    (void)tt_queue_put(&device->sending, (const uint8_t *)"", 1); /* against noise on the line */
    if (send_ack(device, command, true)) /* no row before it */
        tt_scan_start(scan, frames);
    return true;
}

static bool stop(struct tt_device *device, const struct command *command)
{
    if (!tt_scan_stop(&device->scan))
        return false;
    (void)send_rows(device);
    (void)send_ack(device, command, false);
    return true;
}

/* Bytes that a command has, from type to the last field; 0 where it is none of this version. */
static size_t length_of(const struct command *command)
{
    bool first = command->version == 1;
    switch (command->type) {
    case TT_IDENTIFY:
        return first ? TT_V1_IDENTIFY_SIZE : TT_V2_IDENTIFY_SIZE;
    case TT_START:
        return first ? TT_V1_START_SIZE : TT_V2_START_SIZE;
    case TT_STOP:
        return first ? TT_V1_STOP_SIZE : TT_V2_STOP_SIZE;
    case TT_SET_RATE:
        return first ? TT_V1_SET_RATE_SIZE : TT_V2_SET_RATE_SIZE;
    case TT_SET_SCAN:
        return first ? 0 : command->length; /* as many as it has electrodes: see set_scan */
    case TT_KEEP_ALIVE:
        return first ? 0 : TT_V2_KEEP_ALIVE_SIZE;
    default:
        return 0;
    }
}

/* False where it has to be obeyed again, when the row under way has ended. */
static bool carry_out(struct tt_device *device, const struct command *command)
{
    bool first = command->version == 1, done = true;
    switch (command->type) {
    case TT_IDENTIFY:
        if (first)
            send_identity_1(device, command);
        else
            send_identity_2(device, command);
        return true;
    case TT_KEEP_ALIVE:
        send_status(device, command);
        return true;
    case TT_START:
        return start(device, command);
    case TT_STOP:
        return stop(device, command);
    case TT_SET_RATE:
        done = set_rate(device, command->version,
                        tt_get_f32(command->bytes + (first ? TT_V1_SET_RATE_RATE
                                                           : TT_V2_SET_RATE_RATE)));
        break;
    default:
        done = set_scan(device, command);
    }
    if (done)
        (void)send_ack(device, command, device->scan.running);
    else
        send_error(device, command, TT_BAD_VALUE, "no value for this device");
    return true;
}

/* Whether a packet concerns this device, and whether it is answered. */
static bool is_for_me(const struct tt_device *device, struct command *command)
{
    uint8_t own = device->facts->address, address;
    command->answered = true;
    if (command->version != 2)
        return own == TT_NO_ADDRESS;
    if (command->length < TT_V2_IDENTIFY_SIZE)
        return own == TT_NO_ADDRESS;
    address = command->bytes[TT_V2_IDENTIFY_ADDRESS];
    command->answered = address != TT_ALL_ADDRESSES;
    return address == own || address == TT_ALL_ADDRESSES;
}

static bool obey(struct tt_device *device)
{
    struct command command;
    size_t expected;
    command.bytes = device->line;
    command.length = device->command_length;
    command.type = device->line[0];
    command.version = device->line[1];
    command.tag = tt_get_u16(device->line + 2);
    if (!is_for_me(device, &command))
        return true;
    device->heard = tt_board_time();
    if (command.version != 1 && command.version != 2) {
        command.version = 2;
        send_error(device, &command, TT_UNSUPPORTED_VERSION, "versions 1 and 2");
        return true;
    }
    expected = length_of(&command);
    if (expected == 0)
        send_error(device, &command, TT_UNKNOWN_COMMAND, "unknown command");
    else if (expected != command.length || command.length < TT_V1_IDENTIFY_SIZE
             || (command.type == TT_SET_SCAN && command.length < TT_V2_SET_SCAN_SIZE))
        send_error(device, &command, TT_BAD_VALUE, "wrong length");
    else
        return carry_out(device, &command);
    return true;
}

/* A run of bytes between two delimiters is there: true if it is a command. */
static bool is_command(struct tt_device *device)
{
    size_t length = device->line_length, whole;
    device->line_length = 0;
    if (length == 0 || length > sizeof device->line)
        return false;
    whole = tt_cobs_decode(device->line, length);
    if (whole < TT_V1_IDENTIFY_SIZE + TT_CRC_SIZE)
        return false;
    device->command_length = (uint16_t)(whole - TT_CRC_SIZE);
    return tt_crc32(device->line, device->command_length)
        == tt_get_u32(device->line + device->command_length);
}

static bool take_byte(struct tt_device *device, uint8_t byte)
{
    if (byte == 0)
        return is_command(device);
    if (device->line_length < sizeof device->line)
        device->line[device->line_length] = byte;
    if (device->line_length <= sizeof device->line)
        device->line_length++;
    return false;
}

static void stop_if_host_vanished(struct tt_device *device)
{
    if (device->timeout == 0 || tt_board_time() - device->heard < device->timeout)
        return;
    if (tt_scan_stop(&device->scan))
        device->timeout = 0;
}

bool tt_device_poll(struct tt_device *device)
{
    bool any = send_rows(device);
    uint8_t byte;
    if (device->obeying)
        device->obeying = !obey(device);
    while (!device->obeying && tt_queue_get(&device->received, &byte)) {
        if (take_byte(device, byte))
            device->obeying = !obey(device);
        any = true;
    }
    stop_if_host_vanished(device);
    return any;
}
