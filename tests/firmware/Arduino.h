// Declarations of the Arduino cores that the sketches use, to check their syntax: no core was at hand.
#pragma once
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#define PI 3.14159265358979
#define IRAM_ATTR
enum { LOW, HIGH, OUTPUT, INPUT, INPUT_PULLUP, CHANGE, A0 = 14, A1, A2, A3, A4, A5 };
uint32_t micros();
void noInterrupts(), interrupts(), delayMicroseconds(unsigned), pinMode(int, int), digitalWrite(int, int);
int digitalRead(int), analogRead(int), digitalPinToInterrupt(int);
void analogWrite(int, int), analogReadResolution(int), analogWriteResolution(int), attachInterrupt(int, void (*)(), int);
struct Port { void begin(long); int available(), read(), availableForWrite(); size_t write(const uint8_t *, size_t); };
extern Port Serial;
struct Bus { void begin(), setClock(long), beginTransmission(int), write(int); int endTransmission(bool = true), requestFrom(int, int), read(); };
extern Bus Wire;
// Uno R4
struct timer_callback_args_t;
enum { GPT_TIMER, TIMER_MODE_PERIODIC };
struct FspTimer {
    static int8_t get_available_timer(uint8_t &);
    bool begin(int, uint8_t, uint8_t, float, float, void (*)(timer_callback_args_t *)), setup_overflow_irq(), open(), start();
};
struct Wdt { void begin(unsigned), refresh(); };
extern Wdt WDT;
// Teensy 4
struct IntervalTimer { bool begin(void (*)(), unsigned long); };
extern volatile uint32_t CCM_CCGR3, WDOG1_WCR, WDOG1_WSR, SRC_SRSR;
enum { CCM_CCGR_ON = 3, WDOG_WCR_WDE = 4, WDOG_WCR_SRS = 16, WDOG_WCR_WDA = 32, SRC_SRSR_WDOG_RST_B = 16 };
#define CCM_CCGR3_WDOG1(x) ((x) << 16)
#define WDOG_WCR_WT(x) ((x) << 8)
// ESP32
struct hw_timer_t;
hw_timer_t *timerBegin(uint32_t);
void timerAttachInterrupt(hw_timer_t *, void (*)()), timerAlarm(hw_timer_t *, uint64_t, bool, uint64_t);
struct esp_task_wdt_config_t { uint32_t timeout_ms, idle_core_mask; bool trigger_panic; };
int esp_task_wdt_reconfigure(const esp_task_wdt_config_t *), esp_task_wdt_add(void *), esp_task_wdt_reset(), esp_reset_reason();
enum { ESP_RST_TASK_WDT = 6 };
int analogReadMilliVolts(int);
void dacWrite(int, int), ledcWrite(int, int);
bool ledcAttach(int, int, int);
// STM32
enum { TIM2, MICROSEC_FORMAT };
struct HardwareTimer { HardwareTimer(int); void setOverflow(uint32_t, int), attachInterrupt(void (*)()), resume(); };
struct Watchdog { void begin(uint32_t), reload(); bool isReset(bool); };
extern Watchdog IWatchdog;
