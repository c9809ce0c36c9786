/* Arming, protocol and safety around the controller. One step per period: measure, check, command, report. */
#include "firmware.h"

#include "controller.h"

#include <math.h>
#include <string.h>

<% for body in hello %>
static const uint8_t HELLO_${loop.index0}[] = {${body | join(", ")}};
<% endfor %>
enum { VERSION_OFFSET = 0, DIGEST_OFFSET = 8, DIGEST_SIZE = 32 };

static controller joint;
static controller_setpoint setpoint;
static double asked[COMMANDS];
static link_receiver receiver;
static uint8_t state = STATE_DISARMED, fault = CODE_NONE, source;
static bool has_setpoint, has_commands;
static uint16_t sequence, held, missed_periods;
static uint32_t heard; /* us, time of the last valid message */

static void send(uint8_t kind, const uint8_t *body, size_t size)
{
    static link_message message;
    static uint8_t line[LINK_FRAME];
    message.kind = kind;
    message.size = (uint16_t)size;
    message.sequence = sequence++;
    message.time = board_time();
    memcpy(message.body, body, size);
    board_write(line, link_encode(&message, line));
}

static void describe(uint8_t part)
{
<% for body in hello[1:] %>
    if (part == ${loop.index}) {
        send(KIND_CHANNELS, HELLO_${loop.index}, sizeof HELLO_${loop.index});
        return;
    }
<% endfor %>
    (void)part;
    send(KIND_HELLO, HELLO_0, sizeof HELLO_0);
}

static void report(uint8_t code, uint8_t channel, double value)
{
    uint8_t body[6] = {code, channel};
    link_put_float(body + 2, (float)value);
    fault = code;
    send(KIND_FAULT, body, sizeof body);
}

static void vent(uint8_t next)
{
    state = next;
    has_setpoint = has_commands = false;
}

static controller_measurement measured(const double values[MEASUREMENTS])
{
    controller_measurement measurement;
<% for member in measured %>
    measurement.${member} = ${"(%s)values[%d]" % (real, loop.index0) if loop.index0 < readings else 0};
<% endfor %>
    return measurement;
}

static void arm(const link_message *message)
{
    double values[MEASUREMENTS];
    controller_measurement measurement;
    const uint8_t wanted = message->body[0];
    if (state != STATE_DISARMED || message->size != 1 + DIGEST_SIZE || wanted > SOURCE_COMMANDS ||
        !(wanted == SOURCE_SETPOINTS ? has_setpoint : has_commands)) {
        report(CODE_REFUSED, 255, message->kind);
        return;
    }
    if (memcmp(message->body + 1, HELLO_0 + DIGEST_OFFSET, DIGEST_SIZE) != 0) {
        report(CODE_OTHER_DIGEST, 255, 0);
        return;
    }
    board_measure(values);
    measurement = measured(values);
    controller_defaults(&joint);
    if (!controller_init(&joint, (${real})${period}, &measurement)) {
        report((uint8_t)joint.state.fault, 255, 0);
        return;
    }
    source = wanted;
    joint.state.share = 0; /* a ramp from the measured pressures */
    state = STATE_RAMPING;
    fault = CODE_NONE;
}

static void take(const link_message *message)
{
    int i;
    double numbers[SETPOINTS];
    switch (message->kind) {
    case KIND_HELLO:
        describe(message->size > 0 ? message->body[0] : 0);
        break;
    case KIND_ARM:
        arm(message);
        break;
    case KIND_DISARM:
        vent(STATE_DISARMED);
        fault = CODE_NONE;
        break;
    case KIND_VENT:
        vent(STATE_VENTED);
        report(CODE_VENT_ASKED, 255, 0);
        break;
    case KIND_SETPOINT:
        if (message->size != 8 * SETPOINTS) {
            report(CODE_REFUSED, 255, message->kind);
            break;
        }
        for (i = 0; i < SETPOINTS; ++i)
            numbers[i] = link_double(message->body + 8 * i);
<% for member in setpoints %>
        setpoint.${member} = numbers[${loop.index0}];
<% endfor %>
        has_setpoint = true;
        break;
    case KIND_COMMAND:
        if (message->size != 4 * COMMANDS) {
            report(CODE_REFUSED, 255, message->kind);
            break;
        }
        for (i = 0; i < COMMANDS; ++i)
            asked[i] = (double)link_float(message->body + 4 * i);
        has_commands = true;
        break;
    case KIND_HEARTBEAT:
        break;
    default:
        report(CODE_REFUSED, 255, message->kind);
    }
}

void firmware_begin(bool watchdog)
{
    board_vent(true);
    controller_defaults(&joint);
    heard = board_time();
    describe(0);
    if (watchdog) {
        state = STATE_VENTED;
        report(CODE_WATCHDOG, 255, 0);
    }
}

void firmware_receive(uint8_t byte)
{
    static link_message message;
    if (link_receive(&receiver, byte, &message)) {
        heard = board_time();
        take(&message);
    }
}

/* Commands of the host, within the limits of the controller, which holds and vents for it too. */
static void follow_host(const controller_measurement *measurement, controller_commands *commands, controller_telemetry *telemetry)
{
    const controller_parameters *limits = &joint.parameters;
    controller_setpoint inside;
    bool finite = true;
    int i;
    for (i = 0; i < COMMANDS; ++i)
        finite = finite && isfinite(asked[i]);
<% for member in setpoints %>
    inside.${member} = limits->limits_lowest_setpoint_${member};
<% endfor %>
    if (controller_check(&joint, &inside, measurement) != 0 || !finite) {
        controller_hold(&joint, commands, telemetry);
        return;
    }
    if (joint.state.status != STATE_HOLDING) /* as the step counts them */
        joint.state.held = (${real})fmax((double)joint.state.held - ${period}, 0);
    joint.state.status = telemetry->status = STATE_RUNNING;
    telemetry->fault = CODE_NONE;
<% for _ in air %>
<% set k = loop.index0 %>
    commands->pressure${k + 1} = (${real})fmin(fmax(asked[${k}], (double)limits->limits_lowest_commands_${k}), (double)limits->limits_highest_commands_${k});
    joint.state.commands_${k} = commands->pressure${k + 1};
<% endfor %>
}

static void control(const double values[MEASUREMENTS], uint16_t missed, controller_commands *commands)
{
    controller_telemetry telemetry;
    const controller_measurement measurement = measured(values);
    uint8_t before = fault;
    for (; missed > 0; --missed)
        controller_hold(&joint, commands, &telemetry);
    if (source == SOURCE_SETPOINTS)
        controller_step(&joint, &setpoint, &measurement, commands, &telemetry);
    else
        follow_host(&measurement, commands, &telemetry);
    held = (uint16_t)(held + (telemetry.status == STATE_HOLDING));
    if (telemetry.fault != CODE_NONE && telemetry.fault != before)
        report((uint8_t)telemetry.fault, 255, 0);
    if (telemetry.status == STATE_VENTED)
        vent(STATE_VENTED); /* until the host disarms, even if the samples are good again */
    else
        state = (uint8_t)telemetry.status;
}

void firmware_step(uint16_t missed)
{
    controller_commands commands = {0};
    double values[MEASUREMENTS], sent[COMMANDS];
    uint8_t body[10 + 4 * (MEASUREMENTS + COMMANDS)];
    int i;
    bool armed = state != STATE_DISARMED && state != STATE_VENTED;
    missed_periods = (uint16_t)(missed_periods + missed);
    board_measure(values);
    if (armed && board_time() - heard > SILENCE_US) {
        vent(STATE_VENTED);
        report(CODE_HOST_SILENT, 255, 0);
    } else if (armed) {
        control(values, missed < 100 ? missed : 100, &commands);
    }
    armed = state != STATE_DISARMED && state != STATE_VENTED;
<% for _ in air %>
    sent[${loop.index0}] = armed ? (double)commands.pressure${loop.index} : 0;
<% endfor %>
    board_command(sent);
    board_vent(!armed);
    body[0] = state;
    body[1] = fault;
    link_put16(body + 2, held);
    link_put16(body + 4, missed_periods);
    link_put16(body + 6, receiver.lost);
    link_put16(body + 8, receiver.last);
    for (i = 0; i < MEASUREMENTS; ++i)
        link_put_float(body + 10 + 4 * i, (float)values[i]);
    for (i = 0; i < COMMANDS; ++i)
        link_put_float(body + 10 + 4 * (MEASUREMENTS + i), (float)sent[i]);
    send(KIND_SAMPLE, body, sizeof body);
}
