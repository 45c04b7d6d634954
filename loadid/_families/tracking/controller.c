#include "@file@.h"

#include <float.h>
#include <math.h>
#include <string.h>

typedef lt_real real;
typedef lt_belief belief;
typedef lt_tracker tracker;

#ifdef LT_FLOAT
#define SQRT sqrtf
#define LOG logf
#define EXP expf
#define ABS fabsf
#define EPS FLT_EPSILON
#define TINY FLT_MIN
#define FAR_OFF FLT_MAX
#else
#define SQRT sqrt
#define LOG log
#define EXP exp
#define ABS fabs
#define EPS DBL_EPSILON
#define TINY DBL_MIN
#define FAR_OFF DBL_MAX
#endif
#define R(number) ((real)(number))
#ifdef __FAST_MATH__
#error "-ffast-math takes away the test of what is not finite"
#endif

enum { N = LT_STATES, M = LT_SENSORS, P = LT_LOADS };

/* ---- numbers of the fit ------------------------------------------------------------------------------------------ */
@numbers@
/* ---- algebra ----------------------------------------------------------------------------------------------------- */
enum { START, MOVING, STEADY };

static real dot(const real *a, const real *b, int n) {
  real sum = R(0), second = R(0), third = R(0), fourth = R(0); /* four sums at a time: none waits for the one before */
  int i;
  for (i = 0; i + 3 < n; i += 4) {
    sum += a[i] * b[i];
    second += a[i + 1] * b[i + 1];
    third += a[i + 2] * b[i + 2];
    fourth += a[i + 3] * b[i + 3];
  }
  for (; i < n; ++i) sum += a[i] * b[i];
  return (sum + second) + (third + fourth);
}

/* Fold the columns of a (rows, k) into t (rows, width) by Householder reflections, so that the first count rows of t
   are lower triangular and those of a are used up; t t' + a a' stays. */
static void fold(real *t, int width, real *a, int k, int rows, int count) {
  int i, j, c;
  for (j = 0; j < count; ++j) {
    real *own = a + j * k, *diagonal = t + j * width + j;
    real most = R(0), size, first, turn;
    for (c = 0; c < k; ++c) most = ABS(own[c]) > most ? ABS(own[c]) : most;
    if (most >= TINY) {
      if (ABS(*diagonal) > most) most = ABS(*diagonal);
      for (c = 0; c < k; ++c) own[c] /= most; /* squares of small numbers are none in single precision */
      first = *diagonal / most;
      size = SQRT(first * first + dot(own, own, k));
      if (first > R(0)) size = -size;
      first -= size;
      turn = R(-1) / (size * first);
      *diagonal = size * most;
      for (i = j + 1; i < rows; ++i) {
        real *row = a + i * k, *entry = t + i * width + j;
        const real move = turn * (first * *entry + dot(own, row, k));
        *entry -= move * first;
        for (c = 0; c < k; ++c) row[c] -= move * own[c];
      }
    }
    memset(own, 0, (size_t)k * sizeof(real));
  }
}

/* b <- t^-1 b for a lower triangular t (k, k) and b (k, columns). */
static void solve(const real *t, int k, real *b, int columns) {
  int i, j, c;
  for (i = 0; i < k; ++i)
    for (c = 0; c < columns; ++c) {
      real sum = b[i * columns + c];
      for (j = 0; j < i; ++j) sum -= t[i * k + j] * b[j * columns + c];
      b[i * columns + c] = sum / t[i * k + i];
    }
}

/* Channels that are there, and how many. */
static int present(const real *y, int *which) {
  int i, k = 0;
  for (i = 0; i < M; ++i)
    if (isfinite(y[i])) which[k++] = i;
  return k;
}

/* Root (k, k) of the covariance of the noise of k channels. */
static void noise_root(const int *which, int k, real *root) {
  real rows[M * M];
  int i;
  for (i = 0; i < k; ++i) memcpy(rows + i * M, LR + which[i] * M, M * sizeof(real));
  memset(root, 0, (size_t)(k * k) * sizeof(real));
  fold(root, k, rows, M, k, k);
}

/* Row i of H L. */
static void seen(const belief *b, int i, real *row) {
  int j, c;
  memset(row, 0, N * sizeof(real));
  for (j = 0; j < N; ++j) {
    const real h = H[i * N + j];
    if (h != R(0))
      for (c = 0; c < N; ++c) row[c] += h * b->L[j * N + c];
  }
}

/* ---- filter ------------------------------------------------------------------------------------------------------ */
/* One sample later. */
static void predict(tracker *t, belief *b) {
  real x[N], *FL = t->work;
  int i, j, c;
  memset(FL, 0, N * N * sizeof(real));
  for (i = 0; i < N; ++i) {
    x[i] = dot(F + i * N, b->x, N);
    for (j = 0; j < N; ++j) {
      const real f = F[i * N + j];
      if (f != R(0))
        for (c = 0; c < N; ++c) FL[i * N + c] += f * b->L[j * N + c];
    }
  }
#if LT_CORRELATED
  {
    int which[M], k = present(b->y, which);
    real e[M], *T = t->side, *rest = t->rest, row[N];
    memset(T, 0, sizeof(t->side));
    for (i = 0; i < k; ++i) memcpy(rest + i * M, LR + which[i] * M, M * sizeof(real));
    memcpy(rest + k * M, SHARED, sizeof(SHARED));
    if (k > 0) fold(T, k, rest, M, k + N, k);
    for (i = 0; i < k; ++i) e[i] = b->y[which[i]] - dot(H + which[i] * N, b->x, N);
    solve(T, k, e, 1);
    for (i = 0; i < N; ++i) x[i] += dot(T + (k + i) * k, e, k);
    for (j = k - 1; j >= 0; --j) /* T[k:] <- T[k:] T[:k]^-1 */
      for (i = 0; i < N; ++i) {
        real *own = T + (k + i) * k;
        for (c = j + 1; c < k; ++c) own[j] -= own[c] * T[c * k + j];
        own[j] /= T[j * k + j];
      }
    for (j = 0; j < k; ++j) {
      seen(b, which[j], row);
      for (i = 0; i < N; ++i)
        for (c = 0; c < N; ++c) FL[i * N + c] -= T[(k + i) * k + j] * row[c];
    }
    memset(b->L, 0, sizeof(b->L));
    for (i = 0; i < N; ++i) memcpy(b->L + i * N, LQ + i * Q, Q * sizeof(real));
    fold(b->L, N, FL, N, N, N);
    fold(b->L, N, rest + k * M, M, N, N);
  }
#else
  memset(b->L, 0, sizeof(b->L));
  for (i = 0; i < N; ++i) memcpy(b->L + i * N, LQ + i * Q, Q * sizeof(real));
  fold(b->L, N, FL, N, N, N);
#endif
  memcpy(b->x, x, sizeof(x));
}

/* Take up the channels of y that are finite; answers the logarithm of their density. */
static real update(tracker *t, belief *b, const real *y) {
  int which[M], i, j, k = present(y, which);
  real e[M], root[M * M], *T = t->side, *A = t->work, nis, spread = R(0);
#if LT_CORRELATED
  memcpy(b->y, y, sizeof(b->y));
#endif
  if (k == 0) return R(0);
  noise_root(which, k, root);
  memset(T, 0, sizeof(t->side));
  memcpy(T, root, (size_t)(k * k) * sizeof(real));
  for (i = 0; i < k; ++i) {
    seen(b, which[i], A + i * N);
    e[i] = y[which[i]] - dot(H + which[i] * N, b->x, N);
  }
  memcpy(A + k * N, b->L, sizeof(b->L));
  fold(T, k, A, N, k + N, k);
  memcpy(b->L, A + k * N, sizeof(b->L));
  solve(T, k, e, 1);
  for (i = 0; i < N; ++i)
    for (j = 0; j < k; ++j) b->x[i] += T[(k + i) * k + j] * e[j];
  nis = dot(e, e, k);
  for (i = 0; i < k; ++i) spread += LOG(ABS(T[i * k + i]));
  return R(-0.5) * (nis + R(k) * R(LOG2PI)) - spread;
}

#if LT_GATED
/* ---- gate -------------------------------------------------------------------------------------------------------- */
/* What an event of the load adds to a prediction: nothing, events of size c in this sample and count - 1 before it, or,
   where the state was lost, all that the structure moves. */
typedef struct {
  enum { NOTHING, EVENT, ANYWHERE } kind;
  int count;
  real c;
} wider;

static void widen(tracker *t, belief *b, const wider *by) {
  int i, j, k;
  if (by->kind == ANYWHERE) {
    for (i = 0; i < N * REACHED; ++i) t->work[i] = by->c * REACH[i];
    fold(b->L, N, t->work, REACHED, N, N);
  }
  if (by->kind == EVENT)
    for (k = 0; k < by->count; ++k) {
      for (i = 0; i < N; ++i)
        for (j = 0; j < WIDTH; ++j) t->work[i * WIDTH + j] = by->c * WAYS[(k * N + i) * WIDTH + j];
      fold(b->L, N, t->work, WIDTH, N, N);
    }
}

/* Innovations e, NaN where a channel is missing, the std that is expected of them, and which are beyond the gate. */
static int outside(const belief *b, const real *y, real *e, real *spread, int *beyond) {
  real row[N];
  int i, any = 0;
  for (i = 0; i < M; ++i) {
    seen(b, i, row);
    spread[i] = OPENING[i] * SQRT(dot(row, row, N) + dot(LR + i * M, LR + i * M, M));
    e[i] = y[i] - dot(H + i * N, b->x, N);
    beyond[i] = isfinite(e[i]) && ABS(e[i]) > R(GATE) * spread[i];
    any |= beyond[i];
  }
  return any;
}

static void without(real *y, const int *these) {
  int i;
  for (i = 0; i < M; ++i)
    if (these[i]) y[i] = R(NAN);
}

static int count(const int *these) {
  int i, sum = 0;
  for (i = 0; i < M; ++i) sum += these[i] != 0;
  return sum;
}

/* Logarithm of the density of channels that are wrong, each with the variance that makes it most likely. */
static real missed(const real *e, const int *wrong) {
  real sum = R(0);
  int i;
  for (i = 0; i < M; ++i)
    if (wrong[i] && isfinite(e[i]))
      sum -= LOG(ABS(e[i]) > TINY ? ABS(e[i]) : TINY) + R(0.5) * (R(LOG2PI) + R(1)) + R(RARE);
  return sum;
}

/* Root T of the covariance of some innovations of a prediction, with an event in it, each `opened` by its gate. */
static void innovation_root(tracker *t, const belief *b, const wider *by, const int *which, int k, int opened, real *T) {
  int i, j, s;
  noise_root(which, k, T);
  for (i = 0; i < k; ++i) {
    real *row = t->work + i * N;
    seen(b, which[i], row);
    if (opened) {
      for (j = 0; j < N; ++j) row[j] *= OPENING[which[i]];
      for (j = 0; j < k; ++j) T[i * k + j] *= OPENING[which[i]];
    }
  }
  fold(T, k, t->work, N, k, k);
  if (by->kind == ANYWHERE) {
    for (i = 0; i < k; ++i)
      for (j = 0; j < REACHED; ++j) t->work[i * REACHED + j] = by->c * HREACH[which[i] * REACHED + j];
    fold(T, k, t->work, REACHED, k, k);
  }
  if (by->kind == EVENT)
    for (s = 0; s < by->count; ++s) {
      for (i = 0; i < k; ++i)
        for (j = 0; j < WIDTH; ++j) t->work[i * WIDTH + j] = by->c * HWAYS[(s * M + which[i]) * WIDTH + j];
      fold(T, k, t->work, WIDTH, k, k);
    }
}

/* Logarithm of the density of some innovations. */
static real density(tracker *t, const belief *b, const wider *by, const real *e, const int *which, int k, int opened) {
  real T[M * M], z[M], spread = R(0);
  int i;
  if (k == 0) return R(0);
  innovation_root(t, b, by, which, k, opened, T);
  for (i = 0; i < k; ++i) z[i] = e[which[i]];
  solve(T, k, z, 1);
  for (i = 0; i < k; ++i) spread += LOG(ABS(T[i * k + i]));
  return R(-0.5) * (dot(z, z, k) + R(k) * R(LOG2PI)) - spread;
}

/* Rows of a (k, k) made orthogonal by rotations from the left (one-sided Jacobi), which z takes part in. */
static void rotate(real *a, real *z, int k) {
  const real none = EPS * EPS * dot(a, a, k * k); /* rounding of a row that no event moves */
  int sweep, i, j, c, moved = 1;
  for (sweep = 0; sweep < 40 && moved; ++sweep) {
    moved = 0;
    for (i = 0; i < k; ++i)
      for (j = i + 1; j < k; ++j) {
        real *p = a + i * k, *q = a + j * k, cosine, sine, tangent, zeta, old;
        const real pp = dot(p, p, k), qq = dot(q, q, k), pq = dot(p, q, k);
        if (pp <= none || qq <= none || !(ABS(pq) > R(4) * EPS * SQRT(pp) * SQRT(qq))) continue;
        moved = 1;
        zeta = (qq - pp) / (R(2) * pq);
        tangent = R(1) / (ABS(zeta) + SQRT(R(1) + zeta * zeta));
        if (zeta < R(0)) tangent = -tangent;
        cosine = R(1) / SQRT(R(1) + tangent * tangent);
        sine = cosine * tangent;
        for (c = 0; c < k; ++c) {
          old = p[c];
          p[c] = cosine * old - sine * q[c];
          q[c] = sine * old + cosine * q[c];
        }
        old = z[i];
        z[i] = cosine * old - sine * z[j];
        z[j] = sine * old + cosine * z[j];
      }
  }
}

/* Logarithm of the density of whitened innovations under an event of the most likely size, less that of their
   whitening; and that size. */
static real most_likely(const real *toward, const real *white, int k, real *size) {
  real a[M * M], z[M], s2[M], level[2], largest = R(0), mean = R(0), top = R(0), best = -FAR_OFF, step = R(0);
  int i, l, s, sizes = 1;
  memcpy(a, toward, (size_t)(k * k) * sizeof(real));
  memcpy(z, white, (size_t)k * sizeof(real));
  rotate(a, z, k);
  for (i = 0; i < k; ++i) {
    s2[i] = dot(a + i * k, a + i * k, k);
    if (s2[i] > largest) largest = s2[i];
    z[i] *= z[i];
    mean += z[i];
  }
  level[0] = R(1);
  level[1] = R(1) + R(ROUGH * ROUGH) * (mean / R(k));
  if (largest > R(0)) {
    for (i = 0; i < k; ++i)
      if (s2[i] > R(1e-12) * largest && z[i] / s2[i] > top) top = z[i] / s2[i];
    sizes = SCALES;
    step = LOG(top > R(2) ? top : R(2)) / R(SCALES - 1);
  }
  *size = R(0);
  for (l = 0; l < 2; ++l)
    for (s = 0; s < sizes; ++s) {
      const real c2 = largest > R(0) ? EXP(step * R(s)) : R(0);
      real sum = R(0), product = R(1);
      for (i = 0; i < k; ++i) {
        const real var = level[l] + c2 * s2[i];
        sum += z[i] / var;
        product *= var;
        if (product > R(1e15)) {
          sum += LOG(product);
          product = R(1);
        }
      }
      sum = R(-0.5) * (sum + LOG(product) + R(k) * R(LOG2PI)) - R(RARE);
      if (sum > best) {
        best = sum;
        *size = SQRT(c2);
      }
    }
  return best;
}

/* Logarithm of the odds of wrong channels against an event, the prediction that expects it, and its size over that
   which makes the load as large as its prior. e is NaN where a channel is missing or known to be wrong. */
static real event(tracker *t, const belief *b, const real *e, const int *wrong, wider *by, int *lost, real *size) {
  const wider none = {NOTHING, 0, R(0)};
  real T[M * M], toward[M * M], white[M], base, half = R(0), odds = R(INFINITY), least = R(INFINITY), found, c;
  int which[M], right[M] = {0}, i, j, s, k = present(e, which), rights = 0;
  *lost = 0;
  *by = none;
  *size = R(0);
  for (i = 0; i < k; ++i) {
    white[i] = e[which[i]];
    if (!wrong[which[i]]) right[rights++] = which[i];
  }
  base = missed(e, wrong) + density(t, b, &none, e, right, rights, 1);
  innovation_root(t, b, &none, which, k, 1, T);
  for (i = 0; i < k; ++i) half += LOG(ABS(T[i * k + i]));
  base += half;
  solve(T, k, white, 1);
  memset(toward, 0, sizeof(toward));
  for (s = 0; s < RECENT; ++s) {
    real cost;
    for (i = 0; i < k; ++i)
      for (j = 0; j < WIDTH; ++j) t->work[i * WIDTH + j] = HWAYS[(s * M + which[i]) * WIDTH + j];
    solve(T, k, t->work, WIDTH);
    fold(toward, k, t->work, WIDTH, k, k);
    found = base - most_likely(toward, white, k, &c);
    cost = c > R(USUAL) ? found + LOG(c / R(USUAL)) : found;
    if (cost < least) {
      least = cost;
      odds = found;
      *size = c;
      by->kind = EVENT;
      by->count = s + 1;
      by->c = c;
    }
  }
  if (odds > R(DECISIVE) && t->young) {
    for (i = 0; i < k; ++i)
      for (j = 0; j < REACHED; ++j) t->work[i * REACHED + j] = HREACH[which[i] * REACHED + j];
    solve(T, k, t->work, REACHED);
    memset(toward, 0, sizeof(toward));
    fold(toward, k, t->work, REACHED, k, k);
    found = base - most_likely(toward, white, k, &c);
    if (found < odds) {
      by->kind = ANYWHERE;
      by->c = c;
      *size = c;
      *lost = 1;
      return found;
    }
  }
  if (*size > R(FAR * USUAL) && odds < R(2 * DECISIVE)) odds = R(2 * DECISIVE);
  *size /= R(USUAL);
  return odds;
}

/* Which channels are kept out of this sample; answers whether it is the state that is wrong and not they. */
static int held(tracker *t, const real *y, const int *beyond, int *out) {
  int i, outs = 0, there = 0, worst = 0;
  for (i = 0; i < M; ++i) {
    const int here = isfinite(y[i]) != 0;
    if (beyond[i] && t->wrong[i] < MANY) ++t->wrong[i];
    t->good[i] = beyond[i] ? 0 : t->good[i] + (here && t->wrong[i] > 0);
    if (t->wrong[i] > 0 && t->good[i] >= (t->wrong[i] < PATIENCE ? t->wrong[i] : PATIENCE))
      t->wrong[i] = t->good[i] = 0;
    out[i] = here && t->wrong[i] > 0;
    outs += out[i];
    there += here;
    if (t->wrong[i] > worst) worst = t->wrong[i];
  }
  if (2 * outs >= there && worst > PATIENCE) {
    memset(t->wrong, 0, sizeof(t->wrong));
    memset(t->good, 0, sizeof(t->good));
    memset(out, 0, sizeof(t->wrong));
    return 1;
  }
  return 0;
}

/* The state is anywhere: the sample says where. */
static void look(tracker *t, belief *b) {
  const wider all = {ANYWHERE, 0, R(1)};
  t->status |= LT_LOST;
  widen(t, b, &all);
}

/* A sample to the filter that believes; answers the logarithm of the density. y loses what is no event; without
   `taking` the filter stays as it is. */
static real believe(tracker *t, belief *b, real *y, int taking, int *again) {
  real e[M], spread[M], size, odds, found = R(0);
  int beyond[M], which[M], lost, k;
  wider by = {NOTHING, 0, R(0)};
  *again = 0;
  if (outside(b, y, e, spread, beyond)) {
    odds = event(t, b, e, beyond, &by, &lost, &size);
    if (odds <= R(DECISIVE)) {
      found = -R(RARE);
      *again = 1;
    } else {
      by.kind = NOTHING;
      found = missed(e, beyond);
      without(y, beyond);
    }
  }
  if (!taking) {
    k = present(y, which);
    return found + density(t, b, &by, e, which, k, 0);
  }
  widen(t, b, &by);
  return found + update(t, b, y);
}

/* A sample while nothing is in doubt: channels beyond the gate are wrong, or an event begins. */
static void judged(tracker *t, const real *y) {
  real e[M], fresh_e[M], spread[M], odds = R(INFINITY), left[M], size;
  int beyond[M], fresh[M], out[M], i, barred = 0, fresh_ones = 0, lost = 0;
  wider by = {NOTHING, 0, R(0)};
  const int any = outside(&t->state, y, e, spread, beyond);
  memcpy(t->taken, y, sizeof(t->taken));
  for (i = 0; i < M; ++i) barred |= t->wrong[i] > 0;
  if (t->phase == START || (!any && !barred)) {
    update(t, &t->state, y);
    return;
  }
  for (i = 0; i < M; ++i) {
    fresh[i] = beyond[i] && t->wrong[i] == 0;
    fresh_ones += fresh[i];
    fresh_e[i] = t->wrong[i] > 0 ? R(NAN) : e[i];
  }
  if (fresh_ones) odds = event(t, &t->state, fresh_e, fresh, &by, &lost, &size);
  if (isinf(odds) || (odds > R(DECISIVE) && fresh_ones == 1)) {
    if (held(t, y, beyond, out)) look(t, &t->state);
    without(t->taken, out);
    update(t, &t->state, t->taken);
    return;
  }
  for (i = 0; i < M; ++i) beyond[i] = beyond[i] && t->wrong[i] > 0;
  held(t, y, beyond, out);
  without(t->taken, out);
  memcpy(left, t->taken, sizeof(left));
  without(left, fresh);
  memcpy(t->suspects, fresh, sizeof(fresh));
  t->paired = 1;
  t->age = 0;
  if (lost) t->status |= LT_LOST;
  t->doubt = odds;
  t->lean = odds - (odds > R(OPEN) ? R(OPEN) : odds < R(-OPEN) ? R(-OPEN) : odds);
  t->believing = odds <= R(DECISIVE);
  t->rival = t->state;
  {
    belief *with = t->believing ? &t->state : &t->rival, *other = t->believing ? &t->rival : &t->state;
    widen(t, with, &by);
    update(t, with, t->taken);
    update(t, other, left);
  }
  if (!t->believing) memcpy(t->taken, left, sizeof(left));
}

/* A sample to the filter that speaks and to its rival, and what it decides. Answers whether an event was taken up. */
static int compared(tracker *t, const real *given) {
  real y[M], with_it[M], left[M], alone[M], e[M], spread[M], own, other, odds;
  int beyond[M], wrong[M], out[M], i, again, unused, suspects = count(t->suspects), differs = 0, happened;
  belief *with = t->believing ? &t->state : &t->rival, *none = t->believing ? &t->rival : &t->state;
  outside(&t->state, given, e, spread, beyond);
  for (i = 0; i < M; ++i) beyond[i] = beyond[i] && t->wrong[i] > 0;
  held(t, given, beyond, out);
  memcpy(y, given, sizeof(y));
  without(y, out);
  outside(none, y, e, spread, wrong);
  memcpy(left, y, sizeof(left));
  without(left, wrong);
  memcpy(alone, y, sizeof(alone));
  memcpy(with_it, y, sizeof(with_it));
  own = R(0);
  if (suspects == 1) { /* one sensor that is broken stays so: the others are to judge */
    for (i = 0; i < M; ++i)
      if (t->suspects[i] && wrong[i]) {
        alone[i] = R(NAN);
        differs = 1;
      }
    if (differs) own = believe(t, with, alone, 0, &unused);
    for (i = 0; i < M; ++i) out[i] = wrong[i] && !t->suspects[i];
  }
  odds = believe(t, with, with_it, 1, &again);
  if (!differs) own = odds;
  other = update(t, none, left) + missed(e, suspects == 1 ? out : wrong);
  t->doubt += other - own;
  ++t->age;
  memcpy(t->taken, t->believing ? with_it : left, sizeof(left));
  odds = t->doubt - t->lean;
  if (ABS(odds) <= R(DECISIVE) && t->age < PATIENCE) return 0;
  happened = ABS(odds) > R(DECISIVE) ? odds < R(0) : t->believing;
  if (happened != t->believing) t->state = t->rival;
  memcpy(t->taken, happened ? with_it : left, sizeof(left));
  t->believing = happened;
  t->paired = 0;
  if (happened) {
    t->status |= LT_EVENT;
    return 1;
  }
  for (i = 0; i < M; ++i)
    if (wrong[i]) t->wrong[i] = t->age + 1;
  return 0;
}

/* The gate was right. */
static void agreed(tracker *t) {
  if (!t->watched) return;
  t->watched = 0;
  if (t->failed > 0) --t->failed;
}

/* A sample to the filter without a gate, which goes on in place of the other where that is no better. `before` and
   `decided` are of the other: innovations over what this one expects; an event, wrong channels, or neither (-1). */
static void overseen(tracker *t, const real *y, const real *before, int decided) {
  real e[M], spread[M], more = R(0);
  int beyond[M], out[M], i, calm = 1, outs = 0, there = 0, all_out = 1, few, against, failed, wrong = 0;
  outside(&t->plain, y, e, spread, beyond);
  if (!t->watched) {
    t->watched = t->whole = 1;
    t->behind = R(0);
    t->calm = t->since = 0;
    t->decided = -1;
  }
  against = decided >= 0 && t->decided >= 0 && decided != t->decided && t->since < CALM;
  for (i = 0; i < M; ++i) {
    const int here = isfinite(y[i]) != 0;
    out[i] = here && !isfinite(t->taken[i]);
    outs += out[i];
    there += here;
    all_out = all_out && (out[i] || !here);
    wrong |= t->wrong[i] > 0;
  }
  few = 2 * outs < there; /* as many channels as one can do without: they do not count */
  for (i = 0; i < M; ++i) {
    real mine, other;
    if (!isfinite(y[i])) continue;
    mine = ABS(e[i] / spread[i]);
    other = ABS(before[i] / spread[i]);
    mine = mine < R(GATE) ? mine * mine : R(GATE * GATE);
    other = other < R(GATE) ? other * other : R(GATE * GATE);
    if (!(mine < R(GATE * GATE))) calm = 0;
    if (!(few && out[i])) more += other - mine;
  }
  t->calm = calm ? t->calm + (t->calm < MANY) : 0;
  t->behind = t->behind + more > R(0) ? t->behind + more : R(0);
  if (decided < 0) {
    t->since += t->since < MANY;
  } else {
    t->decided = decided;
    t->since = 0;
  }
  t->whole = t->whole && !outs;
  failed = against || t->behind > R((M > 1 + WORSE ? WORSE : M > 1 ? M - 1 : 1) * GATE * GATE);
  if (!failed && !(t->whole && t->calm >= CALM)) {
    update(t, &t->plain, y);
    if (t->since >= OVER && !t->paired && !wrong) agreed(t);
    return;
  }
  if (failed && outs > 1 && all_out) look(t, &t->plain); /* no sensor is right: the state is wrong */
  update(t, &t->plain, y);
  t->state = t->plain;
  memcpy(t->taken, y, sizeof(t->taken));
  t->paired = t->watched = 0;
  memset(t->wrong, 0, sizeof(t->wrong));
  memset(t->good, 0, sizeof(t->good));
  if (failed) {
    if (t->failed < MANY) ++t->failed;
    t->loud = t->samples;
  }
}

/* Whether a sample is believed although it is beyond the gate: that has failed, and nothing was calm since. */
static int aside(tracker *t, const int beyond) {
  unsigned long calm;
  if (!t->failed || t->watched || !beyond) return 0;
  calm = t->samples - t->loud;
  t->loud = t->samples;
  if (calm > (unsigned long)CALM << (t->failed < DOUBLINGS ? t->failed : DOUBLINGS)) return 0;
  t->status |= LT_BELIEVED;
  return 1;
}

/* A sample to whatever runs, from the prediction of the filter that speaks. */
static void judge(tracker *t, const real *y) {
  real before[M], spread[M];
  int beyond[M], barred[M], i, decided = -1, wrong = 0;
  const int any = outside(&t->state, y, before, spread, beyond);
  if (aside(t, any)) {
    memcpy(t->taken, y, sizeof(t->taken));
    update(t, &t->state, y);
    return;
  }
  for (i = 0; i < M; ++i) barred[i] = t->wrong[i] > 0;
  if (t->watched)
    predict(t, &t->plain);
  else
    t->plain = t->state; /* should the gate open */
  if (!t->paired) {
    judged(t, y);
  } else {
    predict(t, &t->rival);
    decided = compared(t, y) ? 1 : -1;
  }
  for (i = 0; i < M; ++i) {
    wrong |= t->wrong[i] > 0;
    if (decided < 0 && t->wrong[i] > 0 && !barred[i]) decided = 0;
  }
  if (!t->watched && !t->paired && !wrong) return;
  if (t->status & LT_LOST) { /* the filter without a gate would not know: it begins anew where the state is */
    t->watched = 0;
    return;
  }
  overseen(t, y, before, decided);
}
#endif

/* ---- interface --------------------------------------------------------------------------------------------------- */
/* Loads and their std of a state. */
static void read_off(const belief *b, real *load, real *std) {
  int i, j, c;
  for (i = 0; i < P; ++i) {
    real row[N];
    memset(row, 0, sizeof(row));
    for (j = 0; j < N; ++j) {
      const real read = CP[i * N + j];
      if (read != R(0))
        for (c = 0; c < N; ++c) row[c] += read * b->L[j * N + c];
    }
    load[i] = dot(CP + i * N, b->x, N);
    std[i] = SQRT(dot(row, row, N));
  }
}

static void answer(const tracker *t, real *load, real *std) {
#if LT_GATED
  int i, calm;
  real off[P], odds, share;
  read_off(&t->state, load, std);
  if (t->watched && (t->paired ? t->believing : t->decided == 1)) {
    calm = 1; /* the filter without a gate, while the event is not told */
    for (i = 0; i < P; ++i) {
      real most;
      off[i] = dot(CP + i * N, t->plain.x, N) - load[i];
      most = ABS(off[i]) > ABS(load[i]) ? ABS(off[i]) : ABS(load[i]);
      calm = calm && most < R(TOLD) * std[i] && (t->calm > 0 || ABS(load[i] + off[i]) < ABS(load[i]));
    }
    for (i = 0; calm && i < P; ++i) {
      load[i] += off[i];
      std[i] = SQRT(std[i] * std[i] + off[i] * off[i]);
    }
  }
  if (!t->paired) return;
  odds = t->doubt - (t->lean < R(0) ? t->lean : R(0));
  share = R(1) / (R(1) + EXP(t->believing ? -odds : odds));
  for (i = 0; i < P; ++i) {
    const real between = load[i] - dot(CP + i * N, t->rival.x, N);
    std[i] = SQRT(std[i] * std[i] + share * (R(1) - share) * between * between);
  }
#else
  read_off(&t->state, load, std);
#endif
}

#if HAS_GAIN
/* A sample at the settled gain; answers whether it was taken: not where a channel is missing or beyond the gate. */
static int steadily(tracker *t, const real *y, real *load) {
  real v[N + M], next[N];
  int i;
  memcpy(v, t->state.x, sizeof(t->state.x));
  memcpy(v + N, y, M * sizeof(real));
  for (i = 0; i < M; ++i) t->innovation[i] = dot(ROWS + (P + i) * (N + M), v, N + M);
  for (i = 0; i < M; ++i)
    if (!(ABS(t->innovation[i]) <= LIMIT[i])) return 0; /* NaN is never smaller */
  for (i = 0; i < P; ++i) load[i] = dot(ROWS + i * (N + M), v, N + M);
  for (i = 0; i < N; ++i) next[i] = dot(ROWS + (P + M + i) * (N + M), v, N + M);
  memcpy(t->state.x, next, sizeof(next));
  memcpy(t->taken, y, sizeof(t->taken));
  t->status |= LT_SETTLED;
  return 1;
}

/* To the settled gain, where the covariance has arrived at its. */
static void settle(tracker *t, const real *y) {
  int i;
#if LT_GATED
  if (t->paired) return;
#endif
  for (i = 0; i < M; ++i)
    if (!isfinite(y[i]) || !isfinite(t->taken[i])) return;
  for (i = 0; i < N; ++i) {
    const real now = dot(t->state.L + i * N, t->state.L + i * N, N);
    if (!(ABS(now - VARIANCE[i]) <= R(ARRIVED) * VARIANCE[i])) return;
  }
  predict(t, &t->state);
  t->phase = STEADY;
#if LT_GATED
  t->young = 0;
  agreed(t);
#endif
}
#endif

void lt_reset(tracker *t) {
  int i;
  memset(t, 0, sizeof(*t));
  for (i = 0; i < N; ++i) {
    t->state.x[i] = X0[i];
    memcpy(t->state.L + i * N, L0 + i * N, N * sizeof(real));
  }
#if LT_GATED
  t->young = 1;
  t->believing = 1;
#endif
}

void lt_reset_moving(tracker *t) {
  lt_reset(t);
  memcpy(t->state.L, MOVED, sizeof(MOVED));
}

unsigned lt_step(tracker *t, const real given[LT_SENSORS], real load[LT_LOADS], real std[LT_LOADS]) {
  real y[M], found[P], spread[P];
  int i;
  ++t->samples;
  t->status = 0;
  for (i = 0; i < M; ++i) {
    y[i] = given[i];
#if HAS_RANGES
    if (y[i] <= LOWEST[i] || y[i] >= HIGHEST[i]) y[i] = R(NAN);
#endif
    if (!isfinite(y[i])) {
      y[i] = R(NAN);
      t->status |= LT_MISSING;
    }
  }
#if HAS_GAIN
  if (t->phase == STEADY && steadily(t, y, found)) {
    memcpy(spread, SETTLED_STD, sizeof(spread));
  } else
#endif
  {
#if HAS_GAIN
    if (t->phase == STEADY) memcpy(t->state.L, AHEAD, sizeof(t->state.L));
#endif
    if (t->phase == MOVING) predict(t, &t->state);
    for (i = 0; i < M; ++i) t->innovation[i] = y[i] - dot(H + i * N, t->state.x, N);
#if LT_GATED
    judge(t, y);
    if (t->paired) t->status |= t->believing ? LT_DOUBT | LT_EVENT : LT_DOUBT;
    for (i = 0; i < M; ++i)
      if (isfinite(y[i]) && !isfinite(t->taken[i])) t->status |= LT_OUT;
#else
    memcpy(t->taken, y, sizeof(y));
    update(t, &t->state, y);
#endif
    t->phase = MOVING;
    answer(t, found, spread);
#if HAS_GAIN
    settle(t, y);
#endif
  }
  for (i = 0; i < P; ++i) {
#if HAS_BOUNDS
    if (!(ABS(found[i]) <= BOUND[i])) {
      found[i] = found[i] > R(0) ? BOUND[i] : -BOUND[i];
      if (!(spread[i] >= BOUND[i])) spread[i] = BOUND[i];
      t->status |= LT_BOUNDED;
    }
#endif
#if HAS_WIDER
    spread[i] *= WIDER[i];
#endif
    if (load) load[i] = found[i];
    if (std) std[i] = spread[i];
  }
  return t->status;
}
