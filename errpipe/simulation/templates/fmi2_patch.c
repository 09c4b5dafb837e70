/* FMI 2.0 co-simulation of a few equations; those stand in equations.h, which is generated.
 *
 * Inputs are held during a step. States start at the first step's inputs. No files, no network, no threads.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define FMI2_OK 0
#define FMI2_WARNING 1
#define FMI2_ERROR 3
#ifdef _WIN32
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif

typedef void *fmi2Component;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer, fmi2Boolean, fmi2Status;
typedef const char *fmi2String;
typedef char fmi2Byte;

#include "equations.h"

/* the real variables: inputs, then outputs; state: see equations.h */
typedef struct {
    double value[INPUTS + OUTPUTS];
    double state[STATES + 1];
    int started;
} Model;

static double table_at(const double *v, int last, double start, double step, double period, double u) {
    double s, f;
    int j;
    if (period > 0.0) { u = fmod(u, period); if (u < 0.0) u += period; }
    s = (u - start) / step;
    if (!(s > 0.0)) return s == s ? v[0] : s;
    if (s >= last) return v[last];
    j = (int)s;
    f = s - j;
    return v[j] * (1.0 - f) + v[j + 1] * f;
}

static double lagged(Model *m, int k, double u, double up, double down, int from_input, double dt) {
    double *y = &m->state[k];
    if (!m->started) *y = from_input ? u : 0.0;
    else *y = u + (*y - u) * exp(-dt / (u >= *y ? up : down));
    return *y;
}

static double first_of(Model *m, int k, double u) {
    if (!m->started) m->state[k] = u;
    return m->state[k];
}

static double switched(Model *m, int k, double u, double on, double off) {
    double *y = &m->state[k];
    if (!m->started) *y = 0.0;
    if (u >= on) *y = 1.0; else if (u <= off) *y = 0.0;
    return *y;
}

static double direction_of(Model *m, int k, double x, double threshold, double start) {
    double *side = &m->state[k], *extreme = &m->state[k + 1];
    if (!m->started) { *side = start; *extreme = x; }
    if (*side * (x - *extreme) >= 0.0) *extreme = x;
    else if (fabs(x - *extreme) > threshold) { *side = -*side; *extreme = x; }
    return *side;
}

static double side_of(Model *m, int k, double v, double start) {
    double *side = &m->state[k];
    if (!m->started) *side = start;
    if (v != 0.0) *side = v > 0.0 ? 1.0 : -1.0;
    return *side;
}

static double approached(Model *m, int k, double x, double side, double length) {
    double *z = &m->state[k], *before = &m->state[k + 1];
    if (!m->started) *z = side;
    else *z = side - (side - *z) * exp(-fabs(x - *before) / length);
    *before = x;
    return *z;
}

/* q'' + 2 damping w q' + w^2 q = w^2 u, exact for an input that runs straight over the step; at rest after a pause */
static double ringing_of(Model *m, int k, double u, double frequency, double damping, double pause, double dt) {
    double *q = &m->state[k], *rate = &m->state[k + 1], *before = &m->state[k + 2];
    double w = 6.283185307179586 * frequency, decay = damping * w, turn = w * sqrt(1.0 - damping * damping);
    if (!m->started || dt > pause) { *q = u; *rate = 0.0; }
    else if (dt > 0.0) {
        double slope = (u - *before) / dt, behind = 2.0 * damping / w * slope;
        double z = *q - *before + behind, v = *rate - slope;
        double fade = exp(-decay * dt), c = cos(turn * dt), s = sin(turn * dt) / turn;
        *q = fade * (z * c + (v + decay * z) * s) + u - behind;
        *rate = fade * (v * c - (decay * v + w * w * z) * s) + slope;
    }
    *before = u;
    return *q;
}

/* the input a time `delay` ago, from a ring of values at least a thousandth of it apart, and the one of now */
#define HISTORY 1100
static double late_of(Model *m, int k, double u, double delay, double dt) {
    double *now = &m->state[k], *newest = &m->state[k + 1], *held = &m->state[k + 2];
    double *at = &m->state[k + 3], *of = at + HISTORY, later, value, then;
    int j, n;
    if (!m->started) { *now = *newest = at[0] = 0.0; *held = 1.0; of[0] = u; }
    *now += dt;
    then = *now - delay;
    later = *now;
    value = u;
    for (j = (int)*newest, n = (int)*held; n > 0; n--, j = (j + HISTORY - 1) % HISTORY) {
        if (at[j] <= then) {
            if (later > at[j]) value = of[j] + (value - of[j]) * (then - at[j]) / (later - at[j]);
            break;
        }
        later = at[j];
        value = of[j];
    }
    j = (int)*newest;
    if (*now - at[j] >= 1e-3 * delay) {
        j = (j + 1) % HISTORY;
        at[j] = *now;
        of[j] = u;
        *newest = j;
        if (*held < HISTORY) *held += 1.0;
    }
    return value;
}

static double power_of(double u, double exponent) { return (u < 0.0 ? -1.0 : u > 0.0) * pow(fabs(u), exponent); }
static double clipped(double u, double low, double high) { return u < low ? low : u > high ? high : u; }

static void evaluate(Model *m, double dt) {
    const double *in = m->value;
    double *out = m->value + INPUTS;
    (void)in; (void)dt;
    EQUATIONS
    m->started = 1;
}

API const char *fmi2GetTypesPlatform(void) { return "default"; }
API const char *fmi2GetVersion(void) { return "2.0"; }
API fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) {
    (void)c; (void)on; (void)n; (void)names;
    return FMI2_OK;
}

static const double starts[INPUTS + OUTPUTS] = {STARTS};

API fmi2Status fmi2Reset(fmi2Component c) {
    Model *m = (Model *)c;
    memset(m, 0, sizeof *m);
    memcpy(m->value, starts, sizeof starts);
    return FMI2_OK;
}

API fmi2Component fmi2Instantiate(fmi2String name, int type, fmi2String guid, fmi2String resources,
                                  const void *functions, fmi2Boolean visible, fmi2Boolean logging) {
    Model *m;
    (void)name; (void)type; (void)resources; (void)functions; (void)visible; (void)logging;
    if (guid && strcmp(guid, GUID) != 0) return NULL;
    m = (Model *)malloc(sizeof *m);
    if (m) fmi2Reset(m);
    return m;
}

API void fmi2FreeInstance(fmi2Component c) { free(c); }

API fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                                   fmi2Boolean has_stop, fmi2Real stop) {
    (void)c; (void)has_tolerance; (void)tolerance; (void)start; (void)has_stop; (void)stop;
    return FMI2_OK;
}

API fmi2Status fmi2EnterInitializationMode(fmi2Component c) { (void)c; return FMI2_OK; }
API fmi2Status fmi2ExitInitializationMode(fmi2Component c) { evaluate((Model *)c, 0.0); return FMI2_OK; }
API fmi2Status fmi2Terminate(fmi2Component c) { (void)c; return FMI2_OK; }

API fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    size_t k;
    for (k = 0; k < n; k++) {
        if (vr[k] >= INPUTS + OUTPUTS) return FMI2_ERROR;
        value[k] = ((Model *)c)->value[vr[k]];
    }
    return FMI2_OK;
}

API fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    size_t k;
    for (k = 0; k < n; k++) {
        if (vr[k] >= INPUTS) return FMI2_ERROR;
        ((Model *)c)->value[vr[k]] = value[k];
    }
    return FMI2_OK;
}

API fmi2Status fmi2DoStep(fmi2Component c, fmi2Real at, fmi2Real step, fmi2Boolean no_set_state) {
    (void)at; (void)no_set_state;
    if (!(step >= 0.0)) return FMI2_ERROR;
    evaluate((Model *)c, step);
    return FMI2_OK;
}

API fmi2Status fmi2GetFMUstate(fmi2Component c, void **state) {
    if (!*state) *state = malloc(sizeof(Model));
    if (!*state) return FMI2_ERROR;
    memcpy(*state, c, sizeof(Model));
    return FMI2_OK;
}
API fmi2Status fmi2SetFMUstate(fmi2Component c, void *state) { memcpy(c, state, sizeof(Model)); return FMI2_OK; }
API fmi2Status fmi2FreeFMUstate(fmi2Component c, void **state) {
    (void)c;
    free(*state);
    *state = NULL;
    return FMI2_OK;
}

/* what a model of real inputs and outputs has nothing to say to */
#define NONE(name, ...) API fmi2Status name(__VA_ARGS__) { return FMI2_ERROR; }
NONE(fmi2GetInteger, fmi2Component c, const fmi2ValueReference *r, size_t n, fmi2Integer *v)
NONE(fmi2GetBoolean, fmi2Component c, const fmi2ValueReference *r, size_t n, fmi2Boolean *v)
NONE(fmi2GetString, fmi2Component c, const fmi2ValueReference *r, size_t n, fmi2String *v)
NONE(fmi2SetInteger, fmi2Component c, const fmi2ValueReference *r, size_t n, const fmi2Integer *v)
NONE(fmi2SetBoolean, fmi2Component c, const fmi2ValueReference *r, size_t n, const fmi2Boolean *v)
NONE(fmi2SetString, fmi2Component c, const fmi2ValueReference *r, size_t n, const fmi2String *v)
NONE(fmi2SerializedFMUstateSize, fmi2Component c, void *s, size_t *n)
NONE(fmi2SerializeFMUstate, fmi2Component c, void *s, fmi2Byte *b, size_t n)
NONE(fmi2DeSerializeFMUstate, fmi2Component c, const fmi2Byte *b, size_t n, void **s)
NONE(fmi2GetDirectionalDerivative, fmi2Component c, const fmi2ValueReference *u, size_t n, const fmi2ValueReference *k,
     size_t m, const fmi2Real *d, fmi2Real *v)
NONE(fmi2SetRealInputDerivatives, fmi2Component c, const fmi2ValueReference *r, size_t n, const fmi2Integer *o,
     const fmi2Real *v)
NONE(fmi2GetRealOutputDerivatives, fmi2Component c, const fmi2ValueReference *r, size_t n, const fmi2Integer *o,
     fmi2Real *v)
NONE(fmi2CancelStep, fmi2Component c)
NONE(fmi2GetStatus, fmi2Component c, int kind, fmi2Status *v)
NONE(fmi2GetRealStatus, fmi2Component c, int kind, fmi2Real *v)
NONE(fmi2GetIntegerStatus, fmi2Component c, int kind, fmi2Integer *v)
NONE(fmi2GetBooleanStatus, fmi2Component c, int kind, fmi2Boolean *v)
NONE(fmi2GetStringStatus, fmi2Component c, int kind, fmi2String *v)
