/* The kernel for pages, compiled to WebAssembly: see pages/kernel.py and steps.js. Formulas of parameters are evaluated by
   the page, and states of proportional loading are handed to it. */
#define IMPORT(name) __attribute__((import_module("env"), import_name(#name)))
#define EXPORT(name) __attribute__((export_name(#name)))
typedef int model_function; /* number of a formula, from 1; 0 for none */
IMPORT(formula) double model_formula(int number, const double *point);
IMPORT(reached) void model_handed(const void *state);
#define MODEL_AT(function, point) model_formula(function, point)
#define MODEL_REACHED(state) model_handed(state)
#include "kernel.h"

static double *outputs;

EXPORT(sizes) model_sizes *sizes(void) { return &model_counts; }
EXPORT(data) model_data *data(void) { return &model_all; }
EXPORT(room) void *room(size_t bytes) { return malloc(bytes); }
EXPORT(outputs) double *outputs_of(void) { return outputs; }

#if MODEL_PATHS
static model_path *path;
#define WORK path->room

EXPORT(ready) int ready(void) {
    path = model_path_new(), outputs = malloc(MODEL_OUTPUTS * sizeof(double));
    return path && outputs;
}

/* The current state: its rows follow each other in one block. */
EXPORT(state) model_state *state(void) { return path->state; }
EXPORT(state_size) size_t state_size(void) { return path->state->size; }

/* Begin at rest at a point; 0 without an answer there. */
EXPORT(rest) int rest(const double *point) {
    memset(path->state->block, 0, path->state->size);
    memcpy(path->state->point, point, MODEL_PARAMETERS * sizeof(double));
    path->begun = 1;
#if MODEL_FLOWS
    path->tangent = 0;
#if MODEL_RUBS
    if (!model_rest_slip(path, point)) return 0;
#endif
#else
    if (!model_set_contact(WORK, point)) return 0;
    WORK->started = 1;
#if MODEL_RUBS
#if MODEL_RANGED
    if (!model_slip_at_rest(path->together->slider, WORK->slack, point, &path->state->slip)) return 0;
#else
    if (!model_slip_at_rest(path->slider, WORK->slack, point, &path->state->slip)) return 0;
#endif
#endif
#endif
    return 1;
}

/* An increment of the current state to a point; 0 if it does not converge. */
EXPORT(go) int go(const double *point, double seconds) {
    model_state *next = &path->pool[MODEL_LAST];
#if MODEL_FLOWS || MODEL_RANGED
    path->seconds = seconds;
#else
    (void)seconds;
#endif
    if (!model_reached(path, path->state, point, next, 0)) return 0;
    model_copy(path->state, next);
    return 1;
}

/* Outputs and amplitudes of the current state. */
EXPORT(tell) void tell(void) {
    model_set_theta(WORK, path->state->point);
    memcpy(WORK->forces, path->state->forces, MODEL_CONDITIONS * sizeof(double));
#if MODEL_FLOWS
    WORK->correction = path->state->correction, WORK->gives = path->gives;
#endif
#if MODEL_FLOATS
    memcpy(WORK->motions, path->state->motions, MODEL_MOTIONS * sizeof(double));
#endif
    model_read(WORK, outputs);
}

#if MODEL_FLOWS
EXPORT(gives) double *gives(void) { return path->gives; }
EXPORT(strain) double *strain(void) { return path->here->strain; }
EXPORT(small) int small(void) { return model_small(path); }
EXPORT(operation) double operation(int code, double a, double b, double c) { return model_operation(code, a, b, c); }
#else
/* Proportional loading to a point from rest; its states are handed over. */
EXPORT(begin) int begin(const double *point, double seconds) {
#if MODEL_RANGED
    path->seconds = seconds;
#else
    (void)seconds;
#endif
    return model_begin(path, point, NULL, NULL) == MODEL_DONE;
}
#endif
#else
static model_work *work;
#define WORK work

EXPORT(ready) int ready(void) {
    work = model_new(), outputs = malloc(MODEL_OUTPUTS * sizeof(double));
    return work && outputs;
}

EXPORT(active) unsigned char *active(void) { return work->active; }

/* The answer at a point, from the statuses that are active, or from those of the free slack; 0 without one. */
EXPORT(solve) int solve(const double *point, int known) {
    if (!model_set_contact(work, point)) return work->started = 0;
#if MODEL_RANGED
    (void)known;
    work->started = model_answered_together(work, point);
#else
    if (!known)
        for (int i = 0; i < MODEL_CONDITIONS; i++) work->active[i] = work->slack[i] < 0;
#if MODEL_FLOATS
    work->started = model_held(work);
#else
    work->started = model_settled(work);
#endif
#endif
    if (work->started) model_read(work, outputs);
    return work->started;
}

/* Outputs at a point for the active statuses; 0 if they are not determined. */
EXPORT(again) int again(const double *point, const double *motions) {
    if (!model_set_contact(work, point)) return 0;
#if MODEL_RANGED
    (void)motions;
    if (!model_answered_together(work, point)) return 0;
#elif MODEL_FLOATS
    double last[MODEL_MOTIONS];
    memcpy(last, motions, sizeof last);
    if (!model_near(work, last)) return 0;
#else
    (void)motions;
    if (!model_equalities(work)) return 0;
#endif
    model_read(work, outputs);
    return model_finite(work);
}

/* S and the free slack at a point; 0 if they are not finite. */
EXPORT(contact) int contact(const double *point) { return model_set_contact(work, point); }
EXPORT(schur) double *schur(void) { return work->schur; }
EXPORT(slack) double *slack(void) { return work->slack; }

/* Gaps of undeformed bodies at the point of the last contact problem. */
EXPORT(opened) double *opened(void) {
    const double *gaps = model_reshaped.rank ? work->gaps : model_gaps;
    for (int i = 0; i < MODEL_CONDITIONS; i++) {
        work->left[i] = 0;
        for (int t = 0; t < MODEL_TERMS; t++) work->left[i] += gaps[i * MODEL_TERMS + t] * work->theta[t];
    }
    return work->left;
}

/* Components of the interpolation of a part along its modes. */
EXPORT(along) double *along(int part, const double *point) {
    model_set_along(&model_parts[part].interpolant, point, work->along);
    return work->along;
}
#endif

EXPORT(theta) double *theta(const double *point) {
    if (point) model_set_theta(WORK, point);
    return WORK->theta;
}
EXPORT(forces) double *forces(void) { return WORK->forces; }
#if MODEL_FLOATS
EXPORT(motions) double *motions(void) { return WORK->motions; }
#endif
