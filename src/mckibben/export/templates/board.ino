// ${title} on ${board}, written by mckibben ${version}. Not yet tried on this board: read it before you connect air.
#include "firmware.h"

#include <Arduino.h>
#include <string.h>
<% if "as5600" in kinds %>
#include <Wire.h>
<% endif %>
<% if board == "uno_r4" %>
#include <FspTimer.h>
#include <WDT.h>
<% elif board == "esp32" %>
#include <esp_system.h>
#include <esp_task_wdt.h>
<% elif board == "stm32" %>
#include <IWatchdog.h>
<% endif %>

static volatile uint16_t ticks; // periods since the last step
<% if board == "esp32" %>
static void IRAM_ATTR tick() { ++ticks; }
<% else %>
static void tick() { ++ticks; }
<% endif %>

// Timer interrupt of the control period, and the watchdog, which resets the board after 100 ms (vent valve: open).
<% if board == "uno_r4" %>
static FspTimer timer;
static void on_timer(timer_callback_args_t *) { tick(); }
static bool begin_timer()
{
    uint8_t kind = GPT_TIMER;
    const int8_t channel = FspTimer::get_available_timer(kind);
    return channel >= 0 && timer.begin(TIMER_MODE_PERIODIC, kind, channel, 1e6f / PERIOD_US, 0.0f, on_timer) &&
           timer.setup_overflow_irq() && timer.open() && timer.start();
}
static void begin_watchdog() { WDT.begin(100); }
static void feed_watchdog() { WDT.refresh(); }
static bool watchdog_reset() { return false; } // the core does not tell
<% elif board == "teensy4" %>
static IntervalTimer timer;
static bool begin_timer() { return timer.begin(tick, (unsigned long)PERIOD_US); }
static void begin_watchdog() // WDOG1: in steps of 0.5 s
{
    CCM_CCGR3 |= CCM_CCGR3_WDOG1(CCM_CCGR_ON);
    WDOG1_WCR = WDOG_WCR_WDE | WDOG_WCR_SRS | WDOG_WCR_WDA | WDOG_WCR_WT(0);
}
static void feed_watchdog()
{
    WDOG1_WSR = 0x5555;
    WDOG1_WSR = 0xAAAA;
}
static bool watchdog_reset() { return (SRC_SRSR & SRC_SRSR_WDOG_RST_B) != 0; }
<% elif board == "esp32" %>
static hw_timer_t *timer;
static bool begin_timer() // core 3
{
    timer = timerBegin(1000000);
    if (!timer)
        return false;
    timerAttachInterrupt(timer, tick);
    timerAlarm(timer, PERIOD_US, true, 0);
    return true;
}
static void begin_watchdog()
{
    esp_task_wdt_config_t settings = {};
    settings.timeout_ms = 100;
    settings.trigger_panic = true;
    esp_task_wdt_reconfigure(&settings);
    esp_task_wdt_add(NULL);
}
static void feed_watchdog() { esp_task_wdt_reset(); }
static bool watchdog_reset() { return esp_reset_reason() == ESP_RST_TASK_WDT; }
<% else %>
static HardwareTimer timer(TIM2);
static bool begin_timer()
{
    timer.setOverflow(PERIOD_US, MICROSEC_FORMAT);
    timer.attachInterrupt(tick);
    timer.resume();
    return true;
}
static void begin_watchdog() { IWatchdog.begin(100000); }
static void feed_watchdog() { IWatchdog.reload(); }
static bool watchdog_reset() { return IWatchdog.isReset(true); }
<% endif %>

static double analog_volts(uint8_t pin)
{
<% if board == "esp32" %>
    return analogReadMilliVolts(pin) * 1e-3;
<% else %>
    return analogRead(pin) * (${volts} / (1 << ${bits}));
<% endif %>
}

static double pressure(uint8_t pin, double low, double high, double pascals) // of a sensor, linear between two voltages
{
    return (analog_volts(pin) - low) / (high - low) * pascals;
}

static void set_output(bool dac, uint8_t pin, double share) // 0 to 1 of the range of the output
{
    const int level = (int)((share < 0 ? 0 : share > 1 ? 1 : share) * ((1 << 12) - 1) + 0.5);
<% if board == "esp32" %>
    if (dac)
        dacWrite(pin, level >> 4);
    else
        ledcWrite(pin, level);
<% else %>
    (void)dac; // the core knows pins with a converter
    analogWrite(pin, level);
<% endif %>
}

<% for angle in angles %>
<% set k = loop.index0 %>
<% if angle.sensor == "quadrature" %>
static volatile int32_t counts_${k};
static void turned_${k}()
{
    static uint8_t last;
    static const int8_t STEP[16] = {0, 1, -1, 0, -1, 0, 0, 1, 1, 0, 0, -1, 0, -1, 1, 0};
    const uint8_t now = (uint8_t)(digitalRead(${angle.pin_a}) << 1 | digitalRead(${angle.pin_b}));
    counts_${k} += STEP[last << 2 | now];
    last = now;
}

<% endif %>
static double angle_${k}() // rad; NAN if the sensor does not answer, so that the controller does not use it
{
<% if angle.sensor == "as5600" %>
<% if angle.channel is not none %>
    Wire.beginTransmission(0x70);
    Wire.write(1 << ${angle.channel}); // of the multiplexer
    if (Wire.endTransmission() != 0)
        return NAN;
<% endif %>
    Wire.beginTransmission(0x36);
    Wire.write(0x0C); // raw angle, 12 bits
    if (Wire.endTransmission(false) != 0 || Wire.requestFrom(0x36, 2) != 2)
        return NAN;
    const int high = Wire.read(), low = Wire.read();
    double angle = ((high << 8 | low) & 0xFFF) * (2 * PI / 4096) - ${angle.zero};
    angle -= 2 * PI * floor(angle / (2 * PI) + 0.5);
<% else %>
    noInterrupts();
    const int32_t now = counts_${k};
    interrupts();
    const double angle = now * (2 * PI / ${angle.counts}) - ${angle.zero};
<% endif %>
    return ${"-" if angle.reversed else ""}angle;
}
<% endfor %>
<% if force %>

static double force() // N, of an HX711; it has a new value every 12.5 ms at best, and the last one is given until then
{
    static double last;
    if (digitalRead(${force.data}) == LOW) {
        uint32_t bits = 0;
        for (int i = 0; i < 25; ++i) { // the 25th pulse selects channel A with gain 128
            noInterrupts(); // a high clock of 60 us switches it off
            digitalWrite(${force.clock}, HIGH);
            delayMicroseconds(1);
            if (i < 24)
                bits = bits << 1 | (digitalRead(${force.data}) == HIGH);
            digitalWrite(${force.clock}, LOW);
            interrupts();
            delayMicroseconds(1);
        }
        last = (((int32_t)(bits << 8) >> 8) - (${force.zero})) * ${force.newtons_per_count};
    }
    return last;
}
<% endif %>

uint32_t board_time(void) { return micros(); }

void board_measure(double values[MEASUREMENTS])
{
<% for _ in angles %>
    values[${loop.index0}] = angle_${loop.index0}();
<% endfor %>
<% for sensor in pressures %>
<% if air[loop.index0] %>
    values[${angles | length + loop.index0}] = pressure(${sensor.pin}, ${sensor.low_volts}, ${sensor.high_volts}, ${sensor.pressure});
<% else %>
    values[${angles | length + loop.index0}] = 0; // it takes no air
<% endif %>
<% endfor %>
<% if force %>
    values[${measurements | length - 1}] = force();
<% endif %>
}

void board_command(const double commands[COMMANDS])
{
<% for valve in valves %>
<% if air[loop.index0] %>
    set_output(${"true" if valve.output == "dac" else "false"}, ${valve.pin}, ${valve.low_share} + commands[${loop.index0}] / ${valve.pressure} * ${valve.high_share - valve.low_share});
<% endif %>
<% endfor %>
}

void board_vent(bool open) { digitalWrite(${vent.pin}, open == ${"false" if vent.open == "low" else "true"}); }

static uint8_t outgoing[2 * LINK_FRAME];
static size_t queued;

void board_write(const uint8_t *bytes, size_t size)
{
    if (queued + size > sizeof outgoing) // never waits: the sequence number shows what was left out
        return;
    memcpy(outgoing + queued, bytes, size);
    queued += size;
}

static void write_queued() // what the buffer of the core takes, which may be shorter than a frame
{
    const int room = Serial.availableForWrite();
    const size_t size = room < (int)queued ? (size_t)(room > 0 ? room : 0) : queued;
    if (size == 0)
        return;
    Serial.write(outgoing, size);
    queued -= size;
    memmove(outgoing, outgoing + size, queued);
}

void setup()
{
    const bool reset = watchdog_reset();
    pinMode(${vent.pin}, OUTPUT);
    board_vent(true);
<% if board != "esp32" %>
    analogReadResolution(${bits});
    analogWriteResolution(12);
<% endif %>
<% for valve in valves %>
<% if board == "esp32" and air[loop.index0] and valve.output == "pwm" %>
    ledcAttach(${valve.pin}, 5000, 12);
<% elif air[loop.index0] and valve.output == "pwm" %>
    pinMode(${valve.pin}, OUTPUT);
<% endif %>
<% endfor %>
<% if "as5600" in kinds %>
    Wire.begin();
    Wire.setClock(400000);
<% endif %>
<% for angle in angles if angle.sensor == "quadrature" %>
<% set k = angles.index(angle) %>
    pinMode(${angle.pin_a}, INPUT_PULLUP);
    pinMode(${angle.pin_b}, INPUT_PULLUP);
    attachInterrupt(digitalPinToInterrupt(${angle.pin_a}), turned_${k}, CHANGE);
    attachInterrupt(digitalPinToInterrupt(${angle.pin_b}), turned_${k}, CHANGE);
<% endfor %>
<% if force %>
    pinMode(${force.clock}, OUTPUT);
    pinMode(${force.data}, INPUT);
<% endif %>
    Serial.begin(921600);
    firmware_begin(reset);
    if (!begin_timer())
        for (;;)
            board_vent(true);
    begin_watchdog();
}

void loop()
{
    while (Serial.available() > 0)
        firmware_receive((uint8_t)Serial.read());
    write_queued();
    noInterrupts();
    const uint16_t passed = ticks;
    ticks = 0;
    interrupts();
    if (passed > 0) {
        firmware_step((uint16_t)(passed - 1));
        feed_watchdog();
    }
}
