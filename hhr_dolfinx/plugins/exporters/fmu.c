/* A model of model.h as a unit for co-simulation, FMI 3.0: parameters are inputs, outputs are outputs, and a step is
   one answer. With friction or inelastic bodies a step is an increment of a path, which begins at rest with proportional
   loading.
   Value references: 0 the time, 1 ... the inputs, then the outputs. */
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include "model.h"

enum { OK = 0, DISCARD = 2, ERROR = 3 };
typedef uint32_t reference;
typedef void (*logger)(void *environment, int status, const char *category, const char *message);

#define PATHS MODEL_PATHS
#if PATHS
typedef model_path work;
#define new_work model_path_new
#define free_work model_path_free
#else
typedef model_work work;
#define new_work model_new
#define free_work model_free
#endif

typedef struct {
    work *work;
    void *environment;
    logger log;
    double time, point[MODEL_PARAMETERS], outputs[MODEL_OUTPUTS + 1];
    int known, begun; /* outputs belong to the current inputs; inputs differ from those of the beginning */
} unit;

#if defined _WIN32
#define SHARED __declspec(dllexport)
#else
#define SHARED __attribute__((visibility("default")))
#endif

static int complaint(unit *u, int status, const char *message) {
    if (u->log) u->log(u->environment, status, "logStatusError", message);
    return status;
}

#if PATHS
static int solved(unit *u) {
    return u->begun ? model_go(u->work, u->point, NULL, u->outputs) : model_begin(u->work, u->point, NULL, u->outputs);
}
#else
static int solved(unit *u) { return model_solve(u->work, u->point, NULL, u->outputs); }
#endif

/* Reports the input that is outside the range of the model. */
static int outside(unit *u) {
    char said[256] = "an input is outside of what the model was made for";
    for (int k = 0; k < MODEL_PARAMETERS; k++)
        if (!(u->point[k] >= model_lower[k] && u->point[k] <= model_upper[k])) {
            snprintf(said, sizeof said, "%s = %g is outside of what the model was made for, %g to %g",
                     model_parameter_names[k], u->point[k], model_lower[k], model_upper[k]);
            break;
        }
    return complaint(u, DISCARD, said);
}

static int answered(unit *u) {
    if (u->known) return OK;
    const int status = solved(u);
    if (status == MODEL_CHANGED) return complaint(u, DISCARD, "a modulus, or a law, does not change on the way");
    if (status == MODEL_OUTSIDE) return outside(u);
    if (status == MODEL_NO_ANSWER) return complaint(u, DISCARD, "the contact problem has no answer for these inputs");
    u->known = 1;
    return OK;
}

/* End of the initialisation: until then the path restarts with each input. */
static int set_out(unit *u) {
    const int status = answered(u);
    if (!status) u->begun = 1;
    return status;
}

/* Point of the outputs: the inputs, or, on a path, the last step. */
static int told(unit *u) { return PATHS && u->begun ? OK : answered(u); }

static void at_start(unit *u) {
    for (int k = 0; k < MODEL_PARAMETERS; k++) u->point[k] = (model_lower[k] + model_upper[k]) / 2;
    u->time = 0, u->known = u->begun = 0;
#ifdef MODEL_FORGETS
    if (u->work) model_forget(u->work);
#endif
}

SHARED const char *fmi3GetVersion(void) { return "3.0"; }
SHARED int fmi3SetDebugLogging(void *instance, _Bool on, size_t count, const char *const categories[]) {
    (void)instance, (void)on, (void)count, (void)categories;
    return OK;
}

SHARED void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, _Bool visible,
                                         _Bool logging, _Bool events, _Bool early, const reference wanted[], size_t count,
                                         void *environment, logger log, void *intermediate) {
    (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)wanted, (void)count;
    (void)intermediate;
    if (!token || strcmp(token, MODEL_TOKEN)) return NULL;
    unit *u = calloc(1, sizeof *u);
    if (!u) return NULL;
    u->environment = environment, u->log = log, u->work = new_work();
    at_start(u);
    if (u->work) return u;
    free(u);
    return NULL;
}
SHARED void fmi3FreeInstance(void *instance) {
    if (!instance) return;
    free_work(((unit *)instance)->work);
    free(instance);
}

SHARED int fmi3EnterInitializationMode(void *instance, _Bool defined, double tolerance, double start, _Bool stops, double stop) {
    (void)defined, (void)tolerance, (void)stops, (void)stop;
    ((unit *)instance)->time = start;
    return OK;
}
SHARED int fmi3ExitInitializationMode(void *instance) { return set_out(instance); }
SHARED int fmi3EnterStepMode(void *instance) { return (void)instance, OK; }
SHARED int fmi3EnterConfigurationMode(void *instance) { return (void)instance, OK; }
SHARED int fmi3ExitConfigurationMode(void *instance) { return (void)instance, OK; }
SHARED int fmi3Terminate(void *instance) { return (void)instance, OK; }
SHARED int fmi3Reset(void *instance) {
    at_start(instance);
    return OK;
}

SHARED int fmi3SetFloat64(void *instance, const reference which[], size_t count, const double values[], size_t sizes) {
    unit *u = instance;
    if (sizes != count) return complaint(u, ERROR, "all variables are scalars");
    for (size_t k = 0; k < count; k++) {
        if (which[k] < 1 || which[k] > MODEL_PARAMETERS) return complaint(u, ERROR, "only inputs may be set");
        u->known = u->known && u->point[which[k] - 1] == values[k];
        u->point[which[k] - 1] = values[k];
    }
    return OK;
}
SHARED int fmi3GetFloat64(void *instance, const reference which[], size_t count, double values[], size_t sizes) {
    unit *u = instance;
    if (sizes != count) return complaint(u, ERROR, "all variables are scalars");
    for (size_t k = 0; k < count; k++) {
        if (which[k] > MODEL_PARAMETERS + MODEL_OUTPUTS) return complaint(u, ERROR, "there is no such variable");
        if (which[k] > MODEL_PARAMETERS) {
            const int status = told(u);
            if (status) return status;
            values[k] = u->outputs[which[k] - 1 - MODEL_PARAMETERS];
        } else {
            values[k] = which[k] ? u->point[which[k] - 1] : u->time;
        }
    }
    return OK;
}

#if !PATHS
/* Derivatives of some outputs along some inputs, times a seed. */
SHARED int fmi3GetDirectionalDerivative(void *instance, const reference unknowns[], size_t unknown_count,
                                        const reference knowns[], size_t known_count, const double seed[],
                                        size_t seed_count, double sensitivity[], size_t sensitivity_count) {
    unit *u = instance;
    double slopes[(MODEL_OUTPUTS + 1) * MODEL_PARAMETERS];
    int status = answered(u);
    if (status) return status;
    if (seed_count != known_count || sensitivity_count != unknown_count) return complaint(u, ERROR, "all variables are scalars");
    if (model_derivatives(u->work, u->point, slopes)) return complaint(u, DISCARD, "there are no derivatives here");
    for (size_t i = 0; i < unknown_count; i++) {
        if (unknowns[i] <= MODEL_PARAMETERS || unknowns[i] > MODEL_PARAMETERS + MODEL_OUTPUTS)
            return complaint(u, ERROR, "an unknown of a derivative is no output");
        sensitivity[i] = 0;
        for (size_t k = 0; k < known_count; k++) {
            if (knowns[k] < 1 || knowns[k] > MODEL_PARAMETERS) return complaint(u, ERROR, "a known of a derivative is no input");
            sensitivity[i] += slopes[(unknowns[i] - 1 - MODEL_PARAMETERS) * MODEL_PARAMETERS + knowns[k] - 1] * seed[k];
        }
    }
    return OK;
}
#endif

SHARED int fmi3DoStep(void *instance, double time, double size, _Bool no_earlier, _Bool *event, _Bool *terminate,
                      _Bool *early, double *last) {
    unit *u = instance;
    (void)no_earlier;
    *event = 0, *terminate = 0, *early = 0, *last = time;
    if (!(size >= 0) || !isfinite(time + size)) return complaint(u, ERROR, "a step must not go back, and time is a number");
#if MODEL_FLOWS || MODEL_REMEMBERS
    if (MODEL_RATED && !(size > 0)) return complaint(u, ERROR, "time must pass in a step");
    if (size > 0) {
        u->work->seconds = size;
        u->known = u->known && !(u->begun && MODEL_RATED); /* a law creeps while its inputs stay */
    }
#endif
    const int status = set_out(u);
    if (status) return status;
    *last = u->time = time + size;
    return OK;
}

/* Functions that a unit of static answers does not support. */
#define NOTHING(name) SHARED int name(void *instance) { return (void)instance, ERROR; }
#if PATHS
NOTHING(fmi3GetDirectionalDerivative)
#endif
#define BOTH(type) NOTHING(fmi3Get##type) NOTHING(fmi3Set##type)
SHARED void *fmi3InstantiateModelExchange(void) { return NULL; }
SHARED void *fmi3InstantiateScheduledExecution(void) { return NULL; }
BOTH(Float32) BOTH(Int8) BOTH(UInt8) BOTH(Int16) BOTH(UInt16) BOTH(Int32) BOTH(UInt32) BOTH(Int64) BOTH(UInt64)
BOTH(Boolean) BOTH(String) BOTH(Binary) BOTH(Clock) BOTH(FMUState) BOTH(IntervalDecimal) BOTH(IntervalFraction)
BOTH(ShiftDecimal) BOTH(ShiftFraction) BOTH(ContinuousStates)
NOTHING(fmi3GetNumberOfVariableDependencies) NOTHING(fmi3GetVariableDependencies) NOTHING(fmi3FreeFMUState)
NOTHING(fmi3SerializedFMUStateSize) NOTHING(fmi3SerializeFMUState) NOTHING(fmi3DeserializeFMUState)
NOTHING(fmi3GetAdjointDerivative) NOTHING(fmi3EnterEventMode) NOTHING(fmi3EvaluateDiscreteStates)
NOTHING(fmi3UpdateDiscreteStates) NOTHING(fmi3EnterContinuousTimeMode) NOTHING(fmi3CompletedIntegratorStep)
NOTHING(fmi3SetTime) NOTHING(fmi3GetContinuousStateDerivatives) NOTHING(fmi3GetEventIndicators)
NOTHING(fmi3GetNominalsOfContinuousStates) NOTHING(fmi3GetNumberOfEventIndicators)
NOTHING(fmi3GetNumberOfContinuousStates) NOTHING(fmi3GetOutputDerivatives) NOTHING(fmi3ActivateModelPartition)
