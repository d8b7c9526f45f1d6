/* MODEL_TITLE: contact and heat, condensed; C99, libm only; written by hhr_dolfinx.

   Forces x, heat flows q and temperatures l of bodies that contact alone feeds solve

       S x + s >= 0,  x >= 0,  x . (S x + s) = 0,  q = a h(x / a, gap) j,  fed bodies pass on what they are given,

   with s and j by q, l and the parameters; where surfaces slide, by the heat of the forces too.

       model_work *work = model_new();
       double point[MODEL_PARAMETERS] = {...}, forces[MODEL_CONDITIONS], outputs[MODEL_OUTPUTS];
       if (model_solve(work, point, forces, outputs) == MODEL_DONE) ...
       model_free(work);

   The first answer is that from contact without heat; further ones start from the answer before, and stay with its balance
   where there are several. model_forget starts anew. One work for each thread; all is static.

   With heat in time MODEL_MODES is not 0, and the last parameter is the temperature at the start. Use instead: model_begin,
   the answer at the start, and model_go, one implicit step of work->seconds each time. */
#ifndef model_HEADER
#define model_HEADER
#define MODEL_REMEMBERS 0
#define MODEL_FORGETS 1 /* answers of a unit that is reset start anew */
#define MODEL_CONDITIONS MECHANICS_CONDITIONS
enum { MODEL_DONE = 0, MODEL_OUTSIDE = 1, MODEL_NO_ANSWER = 2, MODEL_CHANGED = 3 };
#ifndef MODEL_AT /* a page has other ones */
typedef double (*model_function)(const double *);
#define MODEL_AT(function, point) (function)(point)
#endif
#define model_min mechanics_min
#define model_max mechanics_max
#define model_table mechanics_table

/*DATA*/
#define MODEL_PATHS (MODEL_MODES > 0)
#define MODEL_FLOWS MODEL_PATHS
#define MODEL_RATED MODEL_PATHS
#define MODEL_UNKNOWNS (2 * MODEL_CONDITIONS + MODEL_BODIES)
#define MODEL_STEPS 60
#define MODEL_BALANCED 1e-12
#define MODEL_STALLED 1e-8
#define MODEL_GASES 13
#define MODEL_DIFFERENCE 1e-5
#define MODEL_SHORTEST 1e-9
#define MODEL_SHIFT 1e-5

typedef struct {
    mechanics_work *contact;
    double *block, *whole, *slack, *schur, *jump, *made, *per_jump, *supplied, *per_supplied, *factors;
    double *unknown, *there, *residual, *jacobian, *step, *forces, *flows, *gaps, *kept, *amplitudes;
    const double *per_heat, *compliance, *slack_by_friction, *jump_by_friction;
    double scale_slack, scale_force, scale_heat, scale_level, added;
#if MODEL_MODES
    double *stored, *levels, *weights, *per_flow, *heated, *cooled, *slack_rubbed, *jump_rubbed;
    double seconds, length; /* of the next step; of the step whose matrices are known, -1 before the first one */
#endif
    int *pivots;
    unsigned char *active, *before;
    int started;
} model_work;

static inline void model_free(model_work *w) {
    if (!w) return;
    mechanics_free(w->contact);
    free(w->block), free(w->pivots), free(w->active), free(w->before), free(w);
}

/* Work arrays; NULL without memory. */
static inline model_work *model_new(void) {
    const size_t m = MODEL_CONDITIONS, b = MODEL_BODIES, g = MODEL_SLIDING, n = MODEL_UNKNOWNS;
    model_work *w = calloc(1, sizeof *w);
    if (!w) return NULL;
    const mechanics_row rows[] = {
        {&w->whole, MECHANICS_PARAMETERS}, {&w->slack, m}, {&w->schur, m * m}, {&w->jump, m}, {&w->made, m * g + 1},
        {&w->per_jump, m * g + 1}, {&w->supplied, b + 1}, {&w->per_supplied, b * g + 1}, {&w->factors, g + 1},
        {&w->unknown, n}, {&w->there, n}, {&w->residual, n}, {&w->jacobian, n * n}, {&w->step, n}, {&w->forces, m},
        {&w->flows, m + b}, {&w->gaps, m}, {&w->kept, n}, {&w->amplitudes, MODEL_SUPPLIES + 1},
#if MODEL_MODES
        {&w->stored, MODEL_MODES}, {&w->levels, MODEL_MODES}, {&w->weights, MODEL_MODES}, {&w->per_flow, MODEL_MODES * (m + g)},
        {&w->heated, m * m}, {&w->cooled, m * m}, {&w->slack_rubbed, m * g + 1}, {&w->jump_rubbed, m * g + 1},
#endif
    };
    size_t size;
    w->contact = mechanics_new(), w->block = mechanics_block(rows, sizeof rows / sizeof *rows, 0, &size);
    w->pivots = malloc(n * sizeof(int)), w->active = calloc(m, 1), w->before = calloc(m, 1);
    w->per_heat = model_per_heat, w->compliance = model_compliance;
    w->slack_by_friction = model_slack_by_friction, w->jump_by_friction = model_jump_by_friction;
#if MODEL_MODES
    w->seconds = 1, w->length = -1;
#endif
    if (w->contact && w->block && w->pivots && w->active && w->before) return w;
    model_free(w);
    return NULL;
}

/* The next answer starts from contact without heat. */
static inline void model_forget(model_work *w) { w->started = 0; }

/* Conductance of a condition at a pressure and a gap. */
static inline double model_conducted(const model_work *w, const double *point, int i, double pressure, double gap) {
    double values[MODEL_GIVEN + 2];
    if (!model_conductance[i]) return w->added;
    memcpy(values, point, MODEL_GIVEN * sizeof(double));
    values[MODEL_GIVEN] = pressure, values[MODEL_GIVEN + 1] = gap;
    return MODEL_AT(model_conductance[i], values) + w->added;
}

/* Its derivative along the pressure, or along the gap, by a difference. */
static inline double model_conducted_slope(const model_work *w, const double *point, int i, double pressure, double gap, int along) {
    const double at = along ? gap : pressure, size = along ? w->scale_slack : w->scale_force / model_areas[i];
    const double step = fmax(MODEL_DIFFERENCE * at, MODEL_SHORTEST * size), low = fmax(at - step, 0), high = at + step;
    const double below = model_conducted(w, point, i, along ? pressure : low, along ? low : gap);
    const double above = model_conducted(w, point, i, along ? pressure : high, along ? high : gap);
    return (above - below) / (high - low);
}

/* Heat of the conditions that slide over their forces; 0 where it is negative or no number. */
static inline int model_set_factors(model_work *w, const double *point) {
    double values[MODEL_GIVEN + 3];
    memcpy(values, point, MODEL_GIVEN * sizeof(double));
    for (int k = 0; k < MODEL_SLIDING; k++) {
        memcpy(values + MODEL_GIVEN, model_places + k * MODEL_COORDINATES, MODEL_COORDINATES * sizeof(double));
        w->factors[k] = MODEL_AT(model_friction[k], values);
        if (!(w->factors[k] >= 0) || !isfinite(w->factors[k])) return 0;
    }
    return 1;
}

#if MODEL_MODES
/* Matrices of steps of a length. */
static inline void model_set_step(model_work *w, double length) {
    const int m = MODEL_CONDITIONS, g = MODEL_SLIDING, f = m + g;
    if (length == w->length) return;
    for (int k = 0; k < MODEL_MODES; k++) {
        w->weights[k] = 1 / (1 + length * model_rates[k]);
        for (int j = 0; j < f; j++)
            w->per_flow[k * f + j] = w->weights[k] * (model_flowing[k * f + j] - length * model_drained[k * f + j]);
    }
    for (int i = 0; i < m; i++)
        for (int j = 0; j < f; j++) {
            double slack = 0, jump = 0;
            for (int k = 0; k < MODEL_MODES; k++) {
                slack += model_slack_by_mode[i * MODEL_MODES + k] * w->per_flow[k * f + j];
                jump += model_jump_by_mode[i * MODEL_MODES + k] * w->per_flow[k * f + j];
            }
            if (j < m) w->heated[i * m + j] = model_per_heat[i * m + j] + slack, w->cooled[i * m + j] = model_compliance[i * m + j] - jump;
            else {
                w->slack_rubbed[i * g + j - m] = model_slack_by_friction[i * g + j - m] + slack;
                w->jump_rubbed[i * g + j - m] = model_jump_by_friction[i * g + j - m] + jump;
            }
        }
    w->per_heat = w->heated, w->compliance = w->cooled, w->slack_by_friction = w->slack_rubbed, w->jump_by_friction = w->jump_rubbed;
    w->length = length;
}

/* Amplitudes after the step without heat flows. */
static inline void model_set_levels(model_work *w) {
    for (int k = 0; k < MODEL_MODES; k++) {
        double warmed = w->stored[k];
        for (int t = 0; t < MODEL_SUPPLIES; t++)
            warmed += (w->length * model_grown[k * MODEL_SUPPLIES + t] - model_given[k * MODEL_SUPPLIES + t]) * w->amplitudes[t];
        w->levels[k] = w->weights[k] * warmed;
    }
}
#endif

/* Slack, jumps and supplies at a point without forces and flows, and their changes by forces; 0 if not finite. */
static inline int model_set_problem(model_work *w, const double *point) {
    const int m = MODEL_CONDITIONS, b = MODEL_BODIES, g = MODEL_SLIDING;
    double *amplitudes = w->amplitudes;
    memset(w->whole, 0, MECHANICS_PARAMETERS * sizeof(double));
    memcpy(w->whole, point, MODEL_GIVEN * sizeof(double));
    for (int t = 0; t < MODEL_SUPPLIES; t++) amplitudes[t] = MODEL_AT(model_supply[t], point);
#if MODEL_MODES
    model_set_levels(w);
    memcpy(w->whole + MODEL_GIVEN + m + g, w->levels, MODEL_MODES * sizeof(double));
#endif
    if (!mechanics_set_contact(w->contact, w->whole)) return 0;
    memcpy(w->slack, w->contact->slack, m * sizeof(double));
    memcpy(w->schur, w->contact->schur, (size_t)m * m * sizeof(double));
    if (!model_set_factors(w, point)) return 0;
    for (int i = 0; i < m; i++) {
        w->jump[i] = 0;
        for (int t = 0; t < MODEL_SUPPLIES; t++) w->jump[i] += model_jumps[i * MODEL_SUPPLIES + t] * amplitudes[t];
#if MODEL_MODES
        for (int k = 0; k < MODEL_MODES; k++) w->jump[i] += model_jump_by_mode[i * MODEL_MODES + k] * w->levels[k];
#endif
        for (int k = 0; k < g; k++) {
            w->schur[i * m + model_sliding[k]] += w->slack_by_friction[i * g + k] * w->factors[k];
            w->per_jump[i * g + k] = w->jump_by_friction[i * g + k] * w->factors[k];
        }
        if (!isfinite(w->jump[i]) || !isfinite(w->schur[i * m + i])) return 0;
    }
    for (int j = 0; j < b; j++) {
        w->supplied[j] = 0;
        for (int t = 0; t < MODEL_SUPPLIES; t++) w->supplied[j] += model_supplied[j * MODEL_SUPPLIES + t] * amplitudes[t];
        for (int k = 0; k < g; k++) w->per_supplied[j * g + k] = model_supplied_by_friction[j * g + k] * w->factors[k];
        if (!isfinite(w->supplied[j])) return 0;
    }
    return 1;
}

/* Sizes of slack, forces, heat flows and temperatures. */
static inline void model_set_scales(model_work *w, const double *point) {
    const int m = MODEL_CONDITIONS, g = MODEL_SLIDING;
    double compliance = 0, conducted = 0, jump = 0, supplied = 0, rubbed = 0;
    w->scale_slack = 1e-300;
    for (int i = 0; i < m; i++) {
        w->scale_slack = fmax(w->scale_slack, fabs(w->slack[i])), jump = fmax(jump, fabs(w->jump[i]));
        compliance += model_compliances[i] / m;
        for (int k = 0; k < g; k++) rubbed = fmax(rubbed, fabs(w->per_jump[i * g + k]));
    }
    for (int j = 0; j < MODEL_BODIES; j++) supplied = fmax(supplied, fabs(w->supplied[j]));
    w->scale_force = w->scale_slack / fmax(compliance, 1e-300);
    for (int i = 0; i < m; i++) {
        const double through = model_areas[i] * model_conducted(w, point, i, w->scale_force / model_areas[i], 0);
        if (isfinite(through)) conducted = fmax(conducted, through);
    }
    conducted = fmax(conducted, 1e-300), jump = fmax(jump, rubbed * w->scale_force);
    w->scale_level = fmax(fmax(jump, supplied / conducted), 1e-300);
    w->scale_heat = fmax(fmax(conducted * w->scale_level, supplied), 1e-300);
}

/* Forces, flows, gaps and statuses of an unknown; slack is returned in w->gaps for open conditions. */
static inline void model_read_unknown(model_work *w, const double *unknown) {
    const int m = MODEL_CONDITIONS, b = MODEL_BODIES;
    for (int i = 0; i < m; i++) w->forces[i] = unknown[i] * w->scale_force, w->flows[i] = unknown[m + i] * w->scale_heat;
    for (int j = 0; j < b; j++) w->flows[m + j] = unknown[2 * m + j] * w->scale_level;
    for (int i = 0; i < m; i++) {
        double slack = w->slack[i];
        for (int j = 0; j < m; j++) slack += w->schur[i * m + j] * w->forces[j];
        for (int j = 0; j < m + b; j++) slack += w->per_heat[i * (m + b) + j] * w->flows[j];
        w->gaps[i] = slack;
        w->active[i] = w->forces[i] * model_compliances[i] > slack;
    }
}

/* Jump of the temperature of a condition. */
static inline double model_jump_at(const model_work *w, int i) {
    const int m = MODEL_CONDITIONS, b = MODEL_BODIES, g = MODEL_SLIDING;
    double jump = w->jump[i];
    for (int j = 0; j < m; j++) jump -= w->compliance[i * m + j] * w->flows[j];
    for (int j = 0; j < b; j++) jump += model_levels[i * b + j] * w->flows[m + j];
    for (int k = 0; k < g; k++) jump += w->per_jump[i * g + k] * w->forces[model_sliding[k]];
    return jump;
}

/* Residual and derivatives at an unknown; returns the square of the residual, which may not be finite. */
static inline double model_linearised(model_work *w, const double *point, const double *unknown) {
    const int m = MODEL_CONDITIONS, b = MODEL_BODIES, g = MODEL_SLIDING, n = MODEL_UNKNOWNS;
    double square = 0, *a = w->jacobian, *r = w->residual;
    model_read_unknown(w, unknown);
    memset(a, 0, (size_t)n * n * sizeof(double));
    for (int i = 0; i < m; i++) {
        const int closed = w->active[i], row = m + i;
        const double pressure = closed ? fmax(w->forces[i], 0) / model_areas[i] : 0, gap = closed ? 0 : fmax(w->gaps[i], 0);
        const double through = model_areas[i] * model_conducted(w, point, i, pressure, gap), jump = model_jump_at(w, i);
        const double by_pressure = closed && w->forces[i] > 0 ? model_conducted_slope(w, point, i, pressure, gap, 0) * jump : 0;
        const double by_gap = !closed && w->gaps[i] > 0 ? model_areas[i] * model_conducted_slope(w, point, i, pressure, gap, 1) * jump : 0;
        r[i] = closed ? w->gaps[i] / w->scale_slack : unknown[i];
        r[row] = (w->flows[i] - through * jump) / w->scale_heat;
        if (!closed) a[i * n + i] = 1;
        for (int j = 0; j < m; j++) {
            if (closed) a[i * n + j] = w->schur[i * m + j] * (w->scale_force / w->scale_slack);
            if (closed) a[i * n + m + j] = w->per_heat[i * (m + b) + j] * w->scale_heat / w->scale_slack;
            a[row * n + j] = -(by_gap * w->schur[i * m + j] + (i == j ? by_pressure : 0)) * (w->scale_force / w->scale_heat);
            a[row * n + m + j] = through * w->compliance[i * m + j] - by_gap * w->per_heat[i * (m + b) + j] + (i == j);
        }
        for (int j = 0; j < b; j++) {
            const double per_level = w->per_heat[i * (m + b) + m + j];
            if (closed) a[i * n + 2 * m + j] = per_level * w->scale_level / w->scale_slack;
            a[row * n + 2 * m + j] = (-through * model_levels[i * b + j] - by_gap * per_level) * (w->scale_level / w->scale_heat);
        }
        for (int k = 0; k < g; k++)
            a[row * n + model_sliding[k]] -= through * w->per_jump[i * g + k] * (w->scale_force / w->scale_heat);
    }
    for (int j = 0; j < b; j++) {
        double surplus = -w->supplied[j];
        for (int i = 0; i < m; i++) surplus += model_levels[i * b + j] * w->flows[i], a[(2 * m + j) * n + m + i] = model_levels[i * b + j];
        for (int k = 0; k < g; k++) {
            surplus -= w->per_supplied[j * g + k] * w->forces[model_sliding[k]];
            a[(2 * m + j) * n + model_sliding[k]] -= w->per_supplied[j * g + k] * (w->scale_force / w->scale_heat);
        }
        r[2 * m + j] = surplus / w->scale_heat;
    }
    for (int i = 0; i < n; i++) square += r[i] * r[i];
    return square;
}

/* Newton's method from w->unknown, in units of the scales; 1 if it ends. Steps are halved until the residual falls, or does not
   grow tenfold. */
static inline int model_newton(model_work *w, const double *point, int falling) {
    const int m = MODEL_CONDITIONS, n = MODEL_UNKNOWNS;
    double size = HUGE_VAL, square = model_linearised(w, point, w->unknown);
    for (int steps = 0; steps < MODEL_STEPS && isfinite(square); steps++) {
        const double last = size;
        double moved = 0, largest = 1e-300, share = 1;
        for (int i = 0; i < n; i++) w->step[i] = -w->residual[i];
        if (!mechanics_lu(w->jacobian, n, w->pivots)) return 0;
        mechanics_lu_solved(w->jacobian, n, w->pivots, w->step);
        memcpy(w->before, w->active, m);
        const double start = square;
        for (int k = 0; k < (falling ? 30 : 8); k++, share /= 2) {
            for (int i = 0; i < n; i++) w->there[i] = w->unknown[i] + share * w->step[i];
            const double most = falling ? 1 - .1 * share : 10;
            square = model_linearised(w, point, w->there);
            if (isfinite(square) && square <= most * most * start) break;
        }
        memcpy(w->unknown, w->there, n * sizeof(double));
        for (int i = 0; i < n; i++) moved = fmax(moved, fabs(w->step[i])), largest = fmax(largest, fabs(w->unknown[i]));
        size = moved / largest;
        if (!isfinite(size)) return 0;
        if ((size <= MODEL_BALANCED || (size <= MODEL_STALLED && size > last / 2)) && !memcmp(w->before, w->active, m)) return 1;
    }
    return 0;
}

/* Newton's method from w->kept, forces, flows and temperatures, where the answer is kept; 1 if it ends. */
static inline int model_balanced(model_work *w, const double *point, int falling) {
    const int m = MODEL_CONDITIONS, n = MODEL_UNKNOWNS;
    model_set_scales(w, point);
    for (int i = 0; i < n; i++) w->unknown[i] = w->kept[i] / (i < m ? w->scale_force : i < 2 * m ? w->scale_heat : w->scale_level);
    if (!model_newton(w, point, falling)) return 0;
    model_read_unknown(w, w->unknown);
    for (int i = 0; i < m; i++) {
        w->kept[i] = w->active[i] ? w->forces[i] : 0;
        const double gap = w->active[i] ? 0 : fmax(w->gaps[i], 0);
        if (!(model_conducted(w, point, i, w->kept[i] / model_areas[i], gap) >= 0)) return 0;
    }
    memcpy(w->kept + m, w->flows, (m + MODEL_BODIES) * sizeof(double));
    return 1;
}

/* From contact without heat; by gaps that conduct, less and less, where that does not end. */
static inline int model_from_cold(model_work *w, const double *point) {
    const int m = MODEL_CONDITIONS;
    double largest = 0, mean = 0;
    memset(w->kept, 0, MODEL_UNKNOWNS * sizeof(double));
    if (mechanics_solve(w->contact, w->whole, w->kept, NULL) != MECHANICS_DONE) memset(w->kept, 0, m * sizeof(double));
    if (model_balanced(w, point, 0)) return 1;
    memset(w->kept + m, 0, (m + MODEL_BODIES) * sizeof(double));
    for (int i = 0; i < m; i++) {
        const double through = model_conducted(w, point, i, w->kept[i] / model_areas[i], 0);
        if (isfinite(through)) largest = fmax(largest, through);
        mean += w->compliance[i * m + i] / m;
    }
    largest = fmax(largest, 1 / fmax(mean, 1e-300));
    int found = 0;
    for (int k = 0; k <= MODEL_GASES; k++) {
        w->added = k < MODEL_GASES ? largest * pow(10, -k) : 0;
        found = model_balanced(w, point, 0);
        if (!found) found = model_balanced(w, point, 1);
    }
    w->added = 0;
    return found;
}

/* Outputs of the scene, and heat flows and heat of friction of the contacts. */
static inline int model_outputs_of(model_work *w, double *outputs) {
    const int m = MODEL_CONDITIONS, b = MODEL_BODIES, g = MODEL_SLIDING;
    double *whole = w->whole + MODEL_GIVEN;
    memcpy(whole, w->kept + m, m * sizeof(double));
    for (int k = 0; k < g; k++) whole[m + k] = w->factors[k] * w->kept[model_sliding[k]];
#if MODEL_MODES
    (void)b;
    for (int k = 0; k < MODEL_MODES; k++) {
        whole[m + g + k] = w->levels[k];
        for (int j = 0; j < m + g; j++) whole[m + g + k] += w->per_flow[k * (m + g) + j] * whole[j];
    }
#else
    memcpy(whole + m + g, w->kept + 2 * m, b * sizeof(double));
#endif
    for (int i = 0; i < m; i++) w->contact->active[i] = w->kept[i] > 0;
    w->contact->started = 1;
    if (mechanics_solve(w->contact, w->whole, NULL, outputs) != MECHANICS_DONE) return 0;
    for (int k = 0; k < MODEL_CONDUCTING + MODEL_RUBBING; k++) outputs[MECHANICS_OUTPUTS + k] = 0;
    for (int i = 0; i < m; i++)
        if (model_flow_output[i] >= 0) outputs[MECHANICS_OUTPUTS + model_flow_output[i]] += w->kept[m + i];
    for (int k = 0; k < g; k++) outputs[MECHANICS_OUTPUTS + MODEL_CONDUCTING + model_friction_output[k]] += whole[m + k];
    return 1;
}

/* Forces and outputs at a point within the box; either may be NULL. */
static inline int model_answered(model_work *w, const double *point, double *forces, double *outputs) {
    double read[MODEL_OUTPUTS + 1];
    for (int k = 0; k < MODEL_PARAMETERS; k++)
        if (!(point[k] >= model_lower[k] && point[k] <= model_upper[k])) return MODEL_OUTSIDE;
    if (!model_set_problem(w, point)) return MODEL_NO_ANSWER;
    w->started = (w->started && model_balanced(w, point, 0)) || model_from_cold(w, point);
    if (!w->started || !model_outputs_of(w, read)) return MODEL_NO_ANSWER;
    if (forces) memcpy(forces, w->kept, MODEL_CONDITIONS * sizeof(double));
    if (outputs) memcpy(outputs, read, MODEL_OUTPUTS * sizeof(double));
    return MODEL_DONE;
}

#if MODEL_MODES
typedef model_work model_path;
#define model_path_new model_new
#define model_path_free model_free

/* The answer at the start, all of whose nodes have the last parameter as their temperature. */
static inline int model_begin(model_path *w, const double *point, double *forces, double *outputs) {
    for (int k = 0; k < MODEL_MODES; k++) w->stored[k] = model_uniform[k] * point[MODEL_GIVEN];
    w->started = 0;
    model_set_step(w, 0);
    return model_answered(w, point, forces, outputs);
}

/* The answer after a step of w->seconds, positive; the last parameter is not read. Without an answer the state does not change. */
static inline int model_go(model_path *w, const double *point, double *forces, double *outputs) {
    const int f = MODEL_CONDITIONS + MODEL_SLIDING;
    const double *flows = w->whole + MODEL_GIVEN, *levels = flows + f;
    if (!(w->seconds > 0)) return MODEL_OUTSIDE;
    model_set_step(w, w->seconds);
    const int status = model_answered(w, point, forces, outputs);
    for (int k = 0; !status && k < MODEL_MODES; k++) {
        w->stored[k] = levels[k];
        for (int t = 0; t < MODEL_SUPPLIES; t++) w->stored[k] += model_given[k * MODEL_SUPPLIES + t] * w->amplitudes[t];
        for (int j = 0; j < f; j++) w->stored[k] -= model_flowing[k * f + j] * flows[j];
    }
    return status;
}
#else
/* Forces, (MODEL_CONDITIONS), and outputs, (MODEL_OUTPUTS), at a point, (MODEL_PARAMETERS); either may be NULL. */
static inline int model_solve(model_work *w, const double *point, double *forces, double *outputs) {
    return model_answered(w, point, forces, outputs);
}

/* Derivatives of the outputs along the parameters, (MODEL_OUTPUTS, MODEL_PARAMETERS), at the point of the last answer: by
   central differences of answers, one-sided at an end of the box. */
static inline int model_derivatives(model_work *w, const double *point, double *slopes) {
    double there[MODEL_PARAMETERS], ends[2][MODEL_OUTPUTS + 1];
    if (!w->started) return MODEL_NO_ANSWER;
    memcpy(there, point, sizeof there);
    for (int k = 0; k < MODEL_PARAMETERS; k++) {
        const double step = MODEL_SHIFT * (model_upper[k] - model_lower[k]);
        const double low = fmax(model_lower[k], point[k] - step), high = fmin(model_upper[k], point[k] + step);
        for (int end = 0; end < 2; end++) {
            there[k] = end ? high : low;
            const int status = model_solve(w, there, NULL, ends[end]);
            if (status) return status;
        }
        for (int i = 0; i < MODEL_OUTPUTS; i++) slopes[i * MODEL_PARAMETERS + k] = (ends[1][i] - ends[0][i]) / (high - low);
        there[k] = point[k];
    }
    return model_solve(w, point, NULL, NULL);
}
#endif
#endif
