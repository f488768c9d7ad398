/* A body on a hardening spring as a functional mock-up unit of FMI 2 and of FMI 3:
   dx/dt = v, dv/dt = (F - c v - k x - s x^3) / m with m = 2, y = x + b; s = 600. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>

typedef struct { double t, v[9]; int ready; } body_t; /* x v F c k b y dx dv */
static body_t body;

static void *made(void) {
    double start[9] = {0, 0, 0, 1.5, 80.0, 0.0, 0, 0, 0};
    for (int i = 0; i < 9; i++) body.v[i] = start[i];
    body.ready = 0;
    return &body;
}
static void work(body_t *b) {
    double *v = b->v;
    v[7] = v[1];
    v[8] = (v[2] - v[3] * v[1] - v[4] * v[0] - 600.0 * v[0] * v[0] * v[0]) / 2.0;
    v[6] = v[0] + v[5];
}
static int set(body_t *b, const uint32_t *r, size_t n, const double *values) {
    for (size_t i = 0; i < n; i++) {
        /* c, k and b are fixed: once it runs they may not change. */
        if (b->ready && r[i] >= 3 && r[i] <= 5) return 3;
        b->v[r[i]] = values[i];
    }
    return 0;
}
static int get(body_t *b, const uint32_t *r, size_t n, double *values) {
    work(b);
    for (size_t i = 0; i < n; i++) values[i] = b->v[r[i]];
    return 0;
}
static int set_x(body_t *b, const double *x, size_t n) {
    if (!b->ready || n != 2) return 3;
    b->v[0] = x[0], b->v[1] = x[1];
    return 0;
}
static int slopes(body_t *b, double *dx, size_t n) {
    if (!b->ready || n != 2) return 3;
    work(b);
    dx[0] = b->v[7], dx[1] = b->v[8];
    return b->v[0] > 1e3 ? 3 : 0;
}

void *fmi2Instantiate(void *a, int k, void *g, void *r, void *f, int v, int l) { return made(); }
int fmi2Reset(body_t *b) { made(); return 0; }
int fmi2SetupExperiment(body_t *b, int h, double tol, double s, int g, double e) { return 0; }
int fmi2EnterInitializationMode(body_t *b) { return 0; }
int fmi2ExitInitializationMode(body_t *b) { b->ready = 1; return 0; }
int fmi2NewDiscreteStates(body_t *b, void *info) { return 0; }
int fmi2EnterContinuousTimeMode(body_t *b) { return 0; }
int fmi2SetTime(body_t *b, double t) { b->t = t; return 0; }
int fmi2SetReal(body_t *b, const uint32_t *r, size_t n, const double *v) { return set(b, r, n, v); }
int fmi2GetReal(body_t *b, const uint32_t *r, size_t n, double *v) { return get(b, r, n, v); }
int fmi2SetContinuousStates(body_t *b, const double *x, size_t n) { return set_x(b, x, n); }
int fmi2GetDerivatives(body_t *b, double *dx, size_t n) { return slopes(b, dx, n); }

void *fmi3InstantiateModelExchange(void *a, void *g, void *r, _Bool v, _Bool l, void *e, void *f) {
    return made();
}
int fmi3Reset(body_t *b) { made(); return 0; }
int fmi3EnterInitializationMode(body_t *b, _Bool h, double tol, double s, _Bool g, double e) {
    return 0;
}
int fmi3ExitInitializationMode(body_t *b) { b->ready = 1; return 0; }
int fmi3UpdateDiscreteStates(body_t *b, _Bool *n, _Bool *t, _Bool *o, _Bool *v, _Bool *d, double *w) {
    *n = *t = *o = *v = *d = 0;
    return 0;
}
int fmi3EnterContinuousTimeMode(body_t *b) { return 0; }
int fmi3SetTime(body_t *b, double t) { b->t = t; return 0; }
int fmi3SetFloat64(body_t *b, const uint32_t *r, size_t n, const double *v, size_t m) {
    return set(b, r, n, v);
}
int fmi3GetFloat64(body_t *b, const uint32_t *r, size_t n, double *v, size_t m) {
    return get(b, r, n, v);
}
int fmi3SetContinuousStates(body_t *b, const double *x, size_t n) { return set_x(b, x, n); }
int fmi3GetContinuousStateDerivatives(body_t *b, double *dx, size_t n) { return slopes(b, dx, n); }
