
/* Laws of bodies at a point: the machine for their programs, and Newton's method for their unknowns, as in
   plugins/inelastic/local_solver.py. */
#define MODEL_LOCAL 60 /* most Newton iterations for the unknowns of a point */
#define MODEL_SHARED (1.0 / 4096) /* least part of a Newton step that the line search tries */
#define MODEL_SOLVED 1e-9 /* a point is solved by a Newton step below this part of its unknowns */
#define MODEL_NOISE 1e-14 /* round-off of a strain, as its part */
#define MODEL_STILL 1e-12 /* a point does not flow if no slope of its inelastic strain is larger */
enum { MODEL_TRIAL, MODEL_STARTED, MODEL_RESIDUAL, MODEL_AFTER, MODEL_SLOPES, MODEL_IDLE, MODEL_IDLE_SLOPES };

/* Results at a point, and work arrays. */
typedef struct {
    double *block, *work, *stress, *memory, *tangent, *factors, *step, *here;
    int *pivots, solved;
} model_place;

static inline void model_place_free(model_place *p) {
    if (!p) return;
    free(p->block), free(p->pivots), free(p);
}

static inline model_place *model_place_new(void) {
    const size_t c = MODEL_COMPONENTS, n = MODEL_UNKNOWNS;
    model_place *p = calloc(1, sizeof *p);
    if (!p) return NULL;
    const model_row rows[] = {{&p->work, MODEL_REGISTERS}, {&p->stress, c}, {&p->memory, MODEL_MEMORY}, {&p->tangent, c * c},
                              {&p->factors, n * n}, {&p->step, n}, {&p->here, n}};
    size_t size;
    p->block = model_block(MODEL_ROWS(rows), 0, &size), p->pivots = malloc(n * sizeof(int));
    if (p->block && p->pivots) return p;
    model_place_free(p);
    return NULL;
}

static inline double model_operation(int code, double a, double b, double c) {
    switch (code) { /* in the order of their numbers in programs.graph */
    case 0: return a + b;
    case 1: return a - b;
    case 2: return a * b;
    case 3: return a / b;
    case 4: return -a;
    case 5: return sqrt(a);
    case 6: return exp(a);
    case 7: return log(a);
    case 8: return pow(a, b);
    case 9: return fabs(a);
    case 10: return sin(a);
    case 11: return cos(a);
    case 12: return tan(a);
    case 13: return asin(a);
    case 14: return acos(a);
    case 15: return atan(a);
    case 16: return sinh(a);
    case 17: return cosh(a);
    case 18: return tanh(a);
    case 19: return atan2(a, b);
    case 20: return b > a ? b : a;
    case 21: return b < a ? b : a;
    case 22: return a < b;
    case 23: return a <= b;
    case 24: return a == b;
    case 25: return a != 0 && b != 0;
    case 26: return a != 0 || b != 0;
    case 27: return a == 0;
    default: return a != 0 ? b : c;
    }
}

static inline void model_run(const model_program *law, int part, double *work) {
    for (int k = part ? law->ends[part - 1] : 0; k < law->ends[part]; k++) {
        const int *row = law->rows + 5 * (size_t)k;
        work[row[1]] = model_operation(row[0], work[row[2]], work[row[3]], work[row[4]]);
    }
}

static inline double model_out(const model_program *law, int part, int k, const double *work) {
    return work[law->outputs[(part ? law->output_ends[part - 1] : 0) + k]];
}

/* A step of Newton's method by the last factors. */
static inline void model_set_step(const model_program *law, const model_place *p, double *step) {
    for (int i = 0; i < law->unknowns; i++) step[i] = -model_out(law, MODEL_RESIDUAL, i, p->work);
    model_lu_solved(p->factors, law->unknowns, p->pivots, step);
}

/* The largest part of an unknown that a step changes, relative to those of its kind. */
static inline double model_measure(const model_program *law, const double *step, const double *largest) {
    double most = 0;
    for (int i = 0; i < law->unknowns; i++) {
        const double part = step[i] == 0 ? 0 : fabs(step[i]) / largest[law->kinds[i]];
        most = fmax(most, part < INFINITY ? part : INFINITY);
    }
    return most;
}

/* Derivatives of the unknowns by a component of the strain, with the other sign. */
static inline void model_set_slope(const model_program *law, const model_place *p, int j, double *column) {
    const int c = MODEL_COMPONENTS, n = law->unknowns;
    for (int i = 0; i < n; i++) column[i] = model_out(law, MODEL_SLOPES, c * c + c * n + i * c + j, p->work);
    model_lu_solved(p->factors, n, p->pivots, column);
}

/* 1 if the last step is as small as a change of the strain by round-off makes it, as where a point is about to yield. */
static inline int model_round_off(const model_program *law, model_place *p) {
    const int c = MODEL_COMPONENTS, n = law->unknowns;
    double column[MODEL_UNKNOWNS], noise[MODEL_UNKNOWNS], scale = 0;
    memset(noise, 0, sizeof noise);
    for (int i = 0; i < n; i++) p->work[c + i] = p->here[i] + p->step[i];
    model_run(law, MODEL_AFTER, p->work);
    model_run(law, MODEL_SLOPES, p->work);
    for (int j = 0; j < c; j++) {
        model_set_slope(law, p, j, column);
        for (int i = 0; i < n; i++) noise[i] += fabs(column[i]);
        scale = fmax(scale, fmax(fabs(p->work[j]), fabs(p->work[c + n + j])));
    }
    for (int i = 0; i < n; i++)
        if (!(fabs(p->step[i]) <= MODEL_NOISE * scale * noise[i])) return 0;
    return 1;
}

/* 1 if all slopes of the residual are finite: a step by an infinite one is 0, and solves nothing. */
static inline int model_finite_slopes(const model_program *law, const model_place *p) {
    const int n = law->unknowns;
    for (int k = 0; k < n * n; k++)
        if (!isfinite(model_out(law, MODEL_RESIDUAL, n + k, p->work))) return 0;
    return 1;
}

/* Solves for the unknowns from those in the work array; 0 if there is no solution. */
static inline int model_newton(const model_program *law, model_place *p) {
    const int c = MODEL_COMPONENTS, n = law->unknowns;
    double next[MODEL_UNKNOWNS], largest[MODEL_UNKNOWNS], share = 1, last = INFINITY;
    for (int iteration = 0; iteration < MODEL_LOCAL; iteration++) {
        model_run(law, MODEL_RESIDUAL, p->work);
        if (iteration) {
            model_set_step(law, p, next);
            const int nearer = model_measure(law, next, largest) <= (1 - 0.25 * share) * last;
            if (!(nearer && model_finite_slopes(law, p)) && share > MODEL_SHARED) {
                share /= 2;
                for (int i = 0; i < n; i++) p->work[c + i] = p->here[i] + share * p->step[i];
                continue;
            }
        }
        if (!model_finite_slopes(law, p)) return 0;
        memcpy(p->here, p->work + c, n * sizeof(double));
        for (int k = 0; k < n * n; k++) p->factors[k] = model_out(law, MODEL_RESIDUAL, n + k, p->work);
        if (!model_lu(p->factors, n, p->pivots)) return 0;
        model_set_step(law, p, p->step);
        for (int i = 0; i < n; i++) largest[i] = 0;
        for (int i = 0; i < n; i++) {
            double *most = &largest[law->kinds[i]];
            *most = fmax(*most, fmax(fabs(p->here[i]), fabs(p->step[i])));
        }
        for (int i = 0; i < n; i++) p->work[c + i] = p->here[i] + p->step[i];
        share = 1, last = model_measure(law, p->step, largest);
        if (!(last < INFINITY)) return 0;
        if (last <= MODEL_SOLVED) return 1;
    }
    return model_round_off(law, p);
}

/* Inelastic strain, the total one less that of the stress; where nothing flowed it is as before, to the last bit. */
static inline void model_set_inelastic(model_place *p, const double *strain, const double *old, const double *compliance) {
    double size = 0, change = 0;
    for (int i = 0; i < MODEL_COMPONENTS; i++) {
        double found = strain[i];
        for (int j = 0; j < MODEL_COMPONENTS; j++) found -= compliance[i * MODEL_COMPONENTS + j] * p->stress[j];
        p->memory[i] = found;
        size = fmax(size, fmax(fabs(strain[i]), fabs(old[i])));
        change = fmax(change, fabs(p->memory[i] - old[i]));
    }
    if (p->memory[MODEL_COMPONENTS] == old[MODEL_COMPONENTS] && change <= MODEL_NOISE * size)
        memcpy(p->memory, old, MODEL_COMPONENTS * sizeof(double));
}

/* Stress and memory of a law at the end of a step, for C^-1; 0 without an answer. */
static inline int model_solve_law(const model_program *law, model_place *p, const double *strain, const double *old, double dt,
                                  const double *constants, const double *compliance) {
    const int c = MODEL_COMPONENTS, n = law->unknowns, first = c + n + law->memory + 1;
    memcpy(p->work, strain, c * sizeof(double));
    memcpy(p->work + c + n, old, law->memory * sizeof(double));
    p->work[first - 1] = dt;
    memcpy(p->work + first, constants, law->constants * sizeof(double));
    memcpy(p->work + first + law->constants, law->numbers, law->numbers_count * sizeof(double));
    model_run(law, MODEL_TRIAL, p->work);
    p->solved = n > 0 && !(law->output_ends[MODEL_TRIAL] > 0 && model_out(law, MODEL_TRIAL, 0, p->work) <= 0);
    if (p->solved) {
        model_run(law, MODEL_STARTED, p->work);
        for (int i = 0; i < n; i++) p->work[c + i] = model_out(law, MODEL_STARTED, i, p->work);
        if (!model_newton(law, p)) return 0;
    }
    const int part = p->solved ? MODEL_AFTER : MODEL_IDLE;
    model_run(law, part, p->work);
    for (int i = 0; i < c; i++) {
        p->stress[i] = model_out(law, part, i, p->work);
        if (!isfinite(p->stress[i])) return 0;
    }
    for (int i = c; i < law->memory; i++) {
        p->memory[i] = model_out(law, part, i, p->work);
        if (!isfinite(p->memory[i])) return 0;
    }
    model_set_inelastic(p, strain, old, compliance);
    return !law->limited || (n && !p->solved) || model_out(law, part, law->memory, p->work) >= 0;
}

/* Slopes 1 - C^-1 H of the inelastic strain at the point solved last; 1 if the point flows. */
static inline int model_set_slopes(const model_program *law, model_place *p, const double *compliance, double *slopes) {
    const int c = MODEL_COMPONENTS, n = law->unknowns, part = p->solved ? MODEL_SLOPES : MODEL_IDLE_SLOPES;
    double column[MODEL_UNKNOWNS];
    int any = 0;
    model_run(law, part, p->work);
    for (int k = 0; k < c * c; k++) p->tangent[k] = model_out(law, part, k, p->work);
    for (int j = 0; j < c && p->solved; j++) {
        model_set_slope(law, p, j, column);
        for (int i = 0; i < c; i++)
            for (int a = 0; a < n; a++) p->tangent[i * c + j] -= model_out(law, part, c * c + i * n + a, p->work) * column[a];
    }
    for (int i = 0; i < c; i++)
        for (int j = 0; j < c; j++) {
            double slope = i == j;
            for (int l = 0; l < c; l++) slope -= compliance[i * c + l] * p->tangent[l * c + j];
            slopes[i * c + j] = slope;
            any = any || !(fabs(slope) <= MODEL_STILL);
        }
    return any;
}
