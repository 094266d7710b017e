/* The arithmetic of one closed-loop step in plain C: what no implementation can do without.

   Plant (two Runge-Kutta steps), five normal numbers (NumPy's own ziggurat), observer (Heun), set of
   errors (map of a zonotope), tracking.  Left out: faults, decisions, alarms, histories, events,
   braking, recording, conversions of coordinates, and every check. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

typedef struct {
  void *state;
  uint64_t (*next_uint64)(void *);
  uint32_t (*next_uint32)(void *);
  double (*next_double)(void *);
  uint64_t (*next_raw)(void *);
} bitgen_t;
extern double random_standard_normal(bitgen_t *);

enum { A_11, B_12, C_22, O_12, G_1, G_2, VISC_1, VISC_2, COUL_1, COUL_2, SLOPE };
enum { KEPT = 28, COLUMNS = 64 };

/* xoshiro256++ */
static inline uint64_t rotl(uint64_t x, int k) { return (x << k) | (x >> (64 - k)); }
static uint64_t next64(void *p) {
  uint64_t *s = p, result = rotl(s[0] + s[3], 23) + s[0], t = s[1] << 17;
  s[2] ^= s[0]; s[3] ^= s[1]; s[1] ^= s[2]; s[0] ^= s[3]; s[2] ^= t; s[3] = rotl(s[3], 45);
  return result;
}
static uint32_t next32(void *p) { return next64(p) >> 32; }
static double next_double(void *p) { return (next64(p) >> 11) * 0x1.0p-53; }

static void acceleration(const double *x, const double *v, double q1, double q2, const double *c,
                         double *a) {
  double off = c[O_12] + c[B_12] * cos(x[0] - x[1]), swirl = c[B_12] * sin(x[0] - x[1]);
  double relative = v[1] - v[0];
  double t1 = c[VISC_1] * v[0] + c[COUL_1] * M_2_PI * atan(c[SLOPE] * v[0]);
  double t2 = c[VISC_2] * relative + c[COUL_2] * M_2_PI * atan(c[SLOPE] * relative);
  double f1 = q1 - (t1 - t2) - swirl * v[1] * v[1] + c[G_1] * sin(x[0]);
  double f2 = q2 - t2 + swirl * v[0] * v[0] + c[G_2] * sin(x[1]);
  double det = c[A_11] * c[C_22] - off * off;
  a[0] = (c[C_22] * f1 - off * f2) / det;
  a[1] = (c[A_11] * f2 - off * f1) / det;
}

static void rates(const double *x, double q1, double q2, double p1, double p2, const double *c,
                  double *r) {
  acceleration(x, x + 2, q1, q2, c, r + 2);
  r[0] = x[2]; r[1] = x[3]; r[2] += p1; r[3] += p2;
}

static void plant(double *x, double q1, double q2, double p1, double p2, double dt,
                  const double *c) {
  double k1[4], k2[4], k3[4], k4[4], y[4];
  rates(x, q1, q2, p1, p2, c, k1);
  for (int i = 0; i < 4; i++) y[i] = x[i] + 0.5 * dt * k1[i];
  rates(y, q1, q2, p1, p2, c, k2);
  for (int i = 0; i < 4; i++) y[i] = x[i] + 0.5 * dt * k2[i];
  rates(y, q1, q2, p1, p2, c, k3);
  for (int i = 0; i < 4; i++) y[i] = x[i] + dt * k3[i];
  rates(y, q1, q2, p1, p2, c, k4);
  for (int i = 0; i < 4; i++) x[i] += dt / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
}

static void observer_rates(const double *x, const double *v, double q1, double q2,
                           const double *kappa, const double *mu, const double *c, double *d) {
  double r1 = x[2] - v[0], r2 = x[3] - v[1], off = c[O_12] + c[B_12] * cos(x[0] - x[1]), a[2];
  double turning = -c[B_12] * sin(x[0] - x[1]) * (v[0] - v[1]);
  double p1 = c[A_11] * r1 + off * r2, p2 = off * r1 + c[C_22] * r2;
  double c1 = mu[0] * p1 + turning * r2, c2 = mu[1] * p2 + turning * r1;
  double det = c[A_11] * c[C_22] - off * off;
  acceleration(x, v, q1, q2, c, a);
  d[0] = v[0] - kappa[0] * p1;
  d[1] = v[1] - kappa[1] * p2;
  d[2] = a[0] - (c[C_22] * c1 - off * c2) / det;
  d[3] = a[1] - (c[A_11] * c2 - off * c1) / det;
}

static int error_set(double g[4][COLUMNS], int count, double n[4][4], double dt, const double *x,
                     const double *v, const double *a, const double *c, const double *kappa,
                     const double *mu, double *extent) {
  double cosine = cos(x[0] - x[1]), sine = sin(x[0] - x[1]), m[4][4];
  double couple1 = -c[B_12] * (cosine * v[1] * v[1] - sine * a[1]) / c[A_11];
  double couple2 = c[B_12] * (cosine * v[0] * v[0] + sine * a[0]) / c[C_22];
  n[0][2] = -kappa[0] * c[A_11]; n[1][3] = -kappa[1] * c[C_22];
  n[2][0] = c[G_1] * cos(x[0]) / c[A_11] + couple1; n[2][1] = -couple1;
  n[3][0] = couple2; n[3][1] = c[G_2] * cos(x[1]) / c[C_22] - couple2;
  n[2][2] = -mu[0]; n[3][3] = -mu[1];
  for (int r = 0; r < 4; r++)
    for (int q = 0; q < 4; q++) {
      double square = 0.0;
      for (int k = 0; k < 4; k++) square += n[r][k] * n[k][q];
      m[r][q] = dt * n[r][q] + 0.5 * dt * dt * square + (r == q);
    }
  for (int j = 0; j < count; j++) {
    double w[4] = {g[0][j], g[1][j], g[2][j], g[3][j]};
    for (int r = 0; r < 4; r++)
      g[r][j] = m[r][0] * w[0] + m[r][1] * w[1] + m[r][2] * w[2] + m[r][3] * w[3];
  }
  for (int i = 0; i < 2; i++) {
    for (int r = 0; r < 4; r++) g[r][count] = g[r][count + 1] = 0.0;
    g[2 + i][count] = dt * fabs(sin(x[i]));
    g[i][count] = dt * dt * n[i][2 + i];
    g[i][count + 1] = dt;
    count += 2;
  }
  if (count + 4 > COLUMNS) count = KEPT;  /* without the sorting */
  for (int r = 0; r < 4; r++) {
    double total = 0.0;
    for (int j = 0; j < count; j++) total += fabs(g[r][j]);
    extent[r] = total;
  }
  return count;
}

/* Runs n steps towards a reference of n rows (theta, theta', theta''); the final state is in x. */
double floor_run(long n, int substeps, double dt, double noise, const double *c,
                 const double *kappa, const double *mu, const double *m1, const double *m2,
                 const double *reference, double *x) {
  uint64_t seed[4] = {1, 2, 3, 4};
  bitgen_t bits = {seed, next64, next32, next_double, next64};
  double e[4] = {x[0], x[1], x[2], x[3]}, integral[2] = {0.0, 0.0}, g[4][COLUMNS] = {{0.0}};
  double extent[4], map[4][4] = {{0.0}}, v_old[2] = {x[2], x[3]}, q1 = 0.0, q2 = 0.0, sum = 0.0;
  int count = 2;
  g[0][0] = g[1][1] = 0.004;
  for (long k = 0; k < n; k++) {
    const double *w = reference + 6 * k;
    double y[4], d1[4], d2[4], next[4], a[2], d[4];
    for (int i = 0; i < 4; i++)
      y[i] = x[i] + noise * (i < 2 ? 1e-3 : 1e-2) * random_standard_normal(&bits);
    if (k > 0) {
      observer_rates(e, v_old, q1, q2, kappa, mu, c, d1);
      for (int i = 0; i < 4; i++) next[i] = e[i] + dt * d1[i];
      observer_rates(next, y + 2, q1, q2, kappa, mu, c, d2);
      for (int i = 0; i < 4; i++) e[i] += 0.5 * dt * (d1[i] + d2[i]);
    }
    v_old[0] = y[2]; v_old[1] = y[3];
    acceleration(e, y + 2, q1, q2, c, a);
    count = error_set(g, count, map, dt, e, y + 2, a, c, kappa, mu, extent);
    for (int i = 0; i < 2; i++) sum += fabs(y[i] - e[i]) - extent[i];
    double off = c[O_12] + c[B_12] * cos(w[0] - w[1]), swirl = c[B_12] * sin(w[0] - w[1]);
    double relative = w[3] - w[2];
    double t1 = c[VISC_1] * w[2] + c[COUL_1] * M_2_PI * atan(c[SLOPE] * w[2]);
    double t2 = c[VISC_2] * relative + c[COUL_2] * M_2_PI * atan(c[SLOPE] * relative);
    q1 = c[A_11] * w[4] + off * w[5] + swirl * w[3] * w[3] - c[G_1] * sin(w[0]) + t1 - t2;
    q2 = off * w[4] + c[C_22] * w[5] - swirl * w[2] * w[2] - c[G_2] * sin(w[1]) + t2;
    d[0] = y[0] - w[0]; d[1] = y[1] - w[1]; d[2] = e[2] - w[2]; d[3] = e[3] - w[3];
    if (k > 0)
      for (int i = 0; i < 2; i++) integral[i] -= dt * d[i];
    for (int i = 0; i < 4; i++) { q1 += m1[i] * d[i]; q2 += m1[4 + i] * d[i]; }
    for (int i = 0; i < 2; i++) { q1 += m2[i] * integral[i]; q2 += m2[2 + i] * integral[i]; }
    double push = noise * (0.14 + 0.66 * random_standard_normal(&bits));
    for (int s = 0; s < substeps; s++) plant(x, q1, q2, push, 0.0, dt / substeps, c);
  }
  return sum;
}
