#ifndef LT_H
#define LT_H

/* One macro for the type of all numbers, the same wherever this file is included: float or double. */
#if !defined(LT_FLOAT) && !defined(LT_DOUBLE)
#define LT_@TYPE@
#endif
#ifdef LT_FLOAT
typedef float lt_real;
#else
typedef double lt_real;
#endif

#define LT_SENSORS @m@
#define LT_LOADS @p@
#define LT_STATES @n@
#define LT_GATED @gated@      /* 0: every finite number is believed */
#define LT_CORRELATED @correlated@ /* 1: the noise of the sensors moves the structure too */

/* What lt_step answers: a sum of these. */
#define LT_SETTLED 1u   /* the gain is the settled one, and the std that of all such samples */
#define LT_MISSING 2u   /* a channel was not finite, or at the end of its range: the others were used */
#define LT_OUT 4u       /* a channel was kept out, as it was beyond the gate */
#define LT_EVENT 8u     /* an event of the load is taken up, for now or for good */
#define LT_DOUBT 16u    /* an event or wrong channels: two filters run until later samples decide */
#define LT_LOST 32u     /* the state is looked for anew */
#define LT_BELIEVED 64u /* the gate has failed: what is beyond it is believed for a while */
#define LT_BOUNDED 128u /* a load was far beyond those of the fit, and is held there */

#ifdef __cplusplus
extern "C" {
#endif

/* Mean and root of the covariance of the states. */
typedef struct {
  lt_real x[LT_STATES], L[LT_STATES * LT_STATES];
#if LT_CORRELATED
  lt_real y[LT_SENSORS];
#endif
} lt_belief;

/* One tracker. As many as wanted, wherever there is room; lt_reset or
   lt_reset_moving makes one ready. */
typedef struct {
  lt_belief state;
  lt_real work[(LT_SENSORS + LT_STATES) * LT_STATES], side[(LT_SENSORS + LT_STATES) * LT_SENSORS];
#if LT_CORRELATED
  lt_real rest[(LT_SENSORS + LT_STATES) * LT_SENSORS];
#endif
  lt_real innovation[LT_SENSORS]; /* of the last sample; NaN where a channel was missing */
  lt_real taken[LT_SENSORS];      /* the last sample; NaN where a channel was missing or kept out */
  unsigned long samples;          /* since the reset */
  unsigned status;                /* of the last sample */
  int phase;
#if LT_GATED
  lt_belief rival, plain;
  lt_real doubt, lean, behind;
  unsigned long loud;
  int wrong[LT_SENSORS], good[LT_SENSORS], suspects[LT_SENSORS];
  int young, paired, believing, age, watched, whole, calm, since, decided, failed;
#endif
} lt_tracker;

/* Before the first sample of a structure at rest. */
void lt_reset(lt_tracker *t);

/* Before the first sample of one that moves, as loads of the prior keep it moving. */
void lt_reset_moving(lt_tracker *t);

/* Take one sample: y in, NaN where a channel is missing; loads and their std out, each where it is not NULL.
   Answers what happened: LT_SETTLED, LT_MISSING, ... */
unsigned lt_step(lt_tracker *t, const lt_real y[LT_SENSORS], lt_real load[LT_LOADS], lt_real std[LT_LOADS]);

#ifdef __cplusplus
}
#endif

#endif
