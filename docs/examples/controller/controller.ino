// Loads on a board with an FPU and some 50 kB of RAM (Teensy 4, Portenta, Due, ESP32, RP2350):
// tracker.to_c("wind.c", name="wind", dtype="float"), then wind.c and wind.h into the folder of this sketch.
#include "wind.h"

const unsigned long STEP = 10000;  // us from one sample to the next: the step of the fit, in the head of wind.c
const float SCALE = 9.81f * 3.3f / 4096.0f / 0.3f;  // m/s^2 per count: your sensor, in the unit of the fit
const int MIDDLE = 2048, ENDS[2] = {8, 4087};       // counts: at rest, and where the converter saturates

static wind_tracker tracker;
static unsigned long due;

void setup() {
  Serial.begin(115200);
  analogReadResolution(12);
  wind_reset(&tracker);
  due = micros();
}

void loop() {
  while ((long)(micros() - due) < 0) {
  }
  due += STEP;

  wind_real y[WIND_SENSORS], load[WIND_LOADS], std[WIND_LOADS];
  for (int i = 0; i < WIND_SENSORS; ++i) {
    const int counts = analogRead(A0 + i);
    y[i] = counts <= ENDS[0] || counts >= ENDS[1] ? NAN : SCALE * (float)(counts - MIDDLE);
  }
  const unsigned said = wind_step(&tracker, y, load, std);
  const unsigned long took = micros() - (due - STEP);

  Serial.print(load[0]);
  Serial.print(" +- ");
  Serial.print(2 * std[0]);
  if (said & WIND_MISSING) Serial.print(" missing");
  if (said & WIND_OUT) Serial.print(" kept out");
  if (said & (WIND_EVENT | WIND_DOUBT)) Serial.print(" event");
  Serial.print(" us ");
  Serial.println(took);
}
