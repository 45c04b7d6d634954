/* Loads of samples: one row of numbers in (commas, "nan" where a channel is missing), loads and their std out. */
#include <stdio.h>
#include <stdlib.h>

#include "wind.h"

static wind_tracker tracker; /* some kilobytes: not on a small stack */

int main(void) {
  static char row[65536];
  wind_real y[WIND_SENSORS], load[WIND_LOADS], std[WIND_LOADS];
  unsigned said;
  int i;

  wind_reset(&tracker);
  while (fgets(row, sizeof row, stdin)) {
    char *at = row, *end;
    for (i = 0; i < WIND_SENSORS; ++i) {
      y[i] = (wind_real)strtod(at, &end);
      if (end == at) {
        fprintf(stderr, "a row without %d numbers: %s", WIND_SENSORS, row);
        return EXIT_FAILURE;
      }
      at = *end == ',' ? end + 1 : end;
    }
    said = wind_step(&tracker, y, load, std);
    for (i = 0; i < WIND_LOADS; ++i) printf("%.17g,%.17g,", (double)load[i], (double)std[i]);
    printf("%u\n", said);
  }
  return EXIT_SUCCESS;
}
