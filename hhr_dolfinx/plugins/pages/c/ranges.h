
/* Laws of plug-ins on ranges of the conditions, slack = free slack + S x - G q, solved together by a semi-smooth Newton
   method, as in contact/ranges.py: projections of x - c s precede it where it does not converge, or weak springs hold bodies
   that contact alone holds. A law brings three functions of one of its rows, see docs/plug_ins.md. */
#define MODEL_EPSILON 4e-16
#define MODEL_ATTEMPTS 3
#define MODEL_ITERATED 40
#define MODEL_RESTS 1e-12
#define MODEL_WEAKEST 1e-8

/* What a law knows of one of its rows in an increment: numbers, values of its formulas at the end, and its memory at the
   beginning; without memory the seconds are NaN. */
typedef struct {
    const double *numbers, *values, *memory;
    double seconds;
} model_own;

/* The force f(d) of a curve of the closure d >= 0, f(d) + c d = y, and its derivative by y; NaN for a curve that falls. */
static inline double model_resolvent(const model_own *own, double (*curve)(const model_own *, double, double *), double y,
                                     double c, double *slope) {
    double rise, low = 0, high, closure, share;
    const double first = curve(own, 0, &rise);
    *slope = 0;
    if (isnan(first)) return *slope = NAN;
    if (!(y > first)) return *slope = y > 0, fmax(y, 0);
    high = closure = y / c;
    for (int iteration = 0; iteration < 200; iteration++) {
        const double force = curve(own, closure, &rise);
        if (!(rise >= 0)) return *slope = NAN;
        const double left = force + c * closure - y, change = left / (rise + c);
        if (fabs(change) <= MODEL_EPSILON * closure || fabs(left) <= MODEL_EPSILON * y) break;
        if (left < 0) low = closure;
        else high = closure;
        double next = force > 4 * y ? 0.25 * closure : closure - change;
        if (!(next > low && next < high)) next = 0.5 * (low + high);
        closure = next;
    }
    const double force = curve(own, closure, &rise);
    share = rise > 0 ? 1 / (1 + c / rise) : 0;
    *slope = share;
    return rise > c ? y - c * closure : force;
}

/*LAWS*/

/* The contact problem of an increment. P and Q are diagonal, but for friction, whose entries are those of tangential rows. */
typedef struct model_together {
    model_work *room;
    double *block, *schur, *stiffness, *free, *slack, *forces, *start, *off, *noise, *on_forces, *on_slack, *right, *x, *values;
    double *motions;
    unsigned char *status, *active, *seen; /* status: slopes, and what else a law chooses */
    int *place;
    const double *memory;
    double seconds;
#if MODEL_RUBS
    model_slider *slider;
    double *follows, *mixed, *sizes;
#endif
#if MODEL_FLOATS
    double *held, *rigid, *soft, *bare;
    int floats;
#endif
} model_together;

static inline void model_together_free(model_together *t) {
    if (!t) return;
#if MODEL_RUBS
    model_slider_free(t->slider);
#endif
    free(t->block), free(t->status), free(t->place), free(t);
}

static inline model_together *model_together_new(model_work *room) {
    const size_t m = MODEL_CONDITIONS, n = m + MODEL_MOTIONS;
    model_together *t = room ? calloc(1, sizeof *t) : NULL;
    if (!t) return NULL;
    const model_row rows[] = {{&t->schur, m * m}, {&t->stiffness, m}, {&t->free, m}, {&t->slack, m}, {&t->forces, m}, {&t->start, m},
                              {&t->off, m}, {&t->noise, m}, {&t->on_forces, m}, {&t->on_slack, m}, {&t->right, n}, {&t->x, n},
                              {&t->motions, MODEL_MOTIONS}, {&t->values, MODEL_FORMULAS},
#if MODEL_RUBS
                              {&t->follows, MODEL_TANGENTS}, {&t->mixed, MODEL_TANGENTS}, {&t->sizes, MODEL_CONTACTS},
#endif
#if MODEL_FLOATS
                              {&t->rigid, m * m}, {&t->held, m * m}, {&t->soft, m}, {&t->bare, m},
#endif
    };
    size_t size;
    int all = 1;
    t->room = room, t->block = model_block(MODEL_ROWS(rows), 0, &size);
    t->status = malloc(2 * m + m * (MODEL_ITERATED + 1)), t->place = malloc(n * sizeof(int));
#if MODEL_RUBS
    all = (t->slider = model_slider_new(room)) != NULL;
#endif
    if (all && t->block && t->status && t->place) {
        t->active = t->status + m, t->seen = t->active + m;
        return t;
    }
    model_together_free(t);
    return NULL;
}

/* What the law of a range knows of one of its rows. */
static inline model_own model_own_of(const model_together *t, const model_range *range, int k) {
    const model_own own = {range->numbers + k * range->width, t->values + range->first_formula,
                           t->memory ? t->memory + range->first + k * range->memory : NULL, range->remembers ? t->seconds : NAN};
    return own;
}

/* Status of a slope: 0 of an open row; a curve of segments may come back to a row that touches on another one. */
static inline unsigned char model_mark(double slope) {
    unsigned char bytes[sizeof slope], mark = 0;
    memcpy(bytes, &slope, sizeof slope);
    for (size_t k = 0; k < sizeof slope; k++) mark = (unsigned char)(31 * mark + bytes[k]);
    return slope > 0 ? mark | 1 : 0;
}

/* A row by the projection of y = x - c s and its slope J. */
static inline void model_close(model_together *t, int i, double y, double c, double projection, double slope) {
    t->off[i] = t->forces[i] - projection, t->on_forces[i] = 1 - slope, t->on_slack[i] = slope * c;
    t->right[i] = projection - slope * y, t->status[i] = model_mark(slope), t->active[i] = slope > 0 || projection > 0;
}

/* A row of the system, by a weight of the slack of a condition. */
static inline void model_add_slack(const model_together *t, double *row, double weight, int i, int left) {
    for (int b = 0; b < left; b++) row[b] += weight * t->schur[i * MODEL_CONDITIONS + t->place[b]];
#if MODEL_FLOATS
    for (int j = 0; j < MODEL_MOTIONS && t->floats; j++) row[left + j] -= weight * model_taken[i * MODEL_MOTIONS + j];
#endif
}

/* Slack of a condition under the forces that are known, without the others and motions. */
static inline double model_slack_of_known(const model_together *t, const unsigned char *known, int i) {
    double slack = t->free[i];
    for (int j = 0; j < MODEL_CONDITIONS; j++)
        if (known[j] && t->forces[j] != 0) slack += t->schur[i * MODEL_CONDITIONS + j] * t->forces[j];
    return slack;
}

#if MODEL_PATHS
#define MODEL_HALVED 6
#define MODEL_FEWEST 4
#define MODEL_CUTS 12
#define MODEL_CONVERGED 1e-3
#define MODEL_PART_OF_WORK 1e-3
#define MODEL_OPEN 1e-9
#define MODEL_POOL (3 * (MODEL_CUTS + 2))
#define MODEL_LAST (3 * (MODEL_CUTS + 1)) /* index of the end of an increment */

/* State of a path of elastic bodies. */
typedef struct {
    double *block, *point, *forces, *motions;
    double *energy, *time; /* largest elastic energy of contact so far; seconds */
    double *memory;                                    /* of laws of other plug-ins, row by row */
#if MODEL_RUBS
    model_slip slip;
#endif
    size_t size;
} model_state;

/* Room for a state; 0 without memory. */
static inline int model_state_new(model_state *s) {
    const model_row rows[] = {{&s->point, MODEL_PARAMETERS}, {&s->forces, MODEL_CONDITIONS}, {&s->motions, MODEL_MOTIONS},
                              {&s->energy, 1}, {&s->time, 1}, {&s->memory, MODEL_REMEMBERED},
#if MODEL_RUBS
                              MODEL_SLIP_ROWS(s->slip)
#endif
    };
#if MODEL_RUBS
    s->block = model_block(MODEL_ROWS(rows), MODEL_SLIP_BYTES, &s->size);
    if (s->block) s->slip.statuses = (unsigned char *)s->block + s->size - MODEL_SLIP_BYTES;
#else
    s->block = model_block(MODEL_ROWS(rows), 0, &s->size);
#endif
    return s->block != NULL;
}

#endif

/*RUBBING*/

/* All laws at the current forces and slacks, for the forces per slack c of all rows. */
static inline void model_linear(model_together *t, const double *c, int attempt) {
    for (int r = 0; r < MODEL_RANGES; r++) {
        const model_range *range = &model_ranges[r];
#if MODEL_RUBS
        if (range->law < 0) {
            model_linear_friction(t, c, attempt);
            continue;
        }
#endif
        for (int k = 0; k < range->count; k++) {
            const int i = range->rows[k];
            const double y = t->forces[i] - c[i] * t->slack[i];
            double slope = y > 0, projection = fmax(y, 0);
            if (range->law) {
                const model_own own = model_own_of(t, range, k);
                projection = model_law_projection(range->law, &own, y, c[i], &slope);
            }
            model_close(t, i, y, c[i], projection, slope);
        }
    }
    (void)attempt;
}

/* Deviations beyond their round-off: the largest, over it. */
static inline double model_worst(model_together *t) {
    const int m = MODEL_CONDITIONS;
    double most = 0, worst = 0;
    for (int i = 0; i < m; i++) most = fmax(most, fabs(t->forces[i]));
    for (int i = 0; i < m; i++) {
        double terms = fabs(t->free[i]); /* a slack is not more exact than the terms of its sum */
        for (int j = 0; j < m; j++) terms += fabs(t->schur[i * m + j] * t->forces[j]);
#if MODEL_FLOATS
        for (int j = 0; j < MODEL_MOTIONS && t->floats; j++) terms += fabs(model_taken[i * MODEL_MOTIONS + j] * t->motions[j]);
#endif
        t->noise[i] = MODEL_EPSILON * t->stiffness[i] * terms + MODEL_ROUND_OFF * most + 1e-300;
    }
    for (int r = 0; r < MODEL_RANGES; r++) {
        double own = 0;
        for (int k = 0; k < model_ranges[r].count; k++) own = fmax(own, fabs(t->forces[model_ranges[r].rows[k]]));
        for (int k = 0; k < model_ranges[r].count; k++) {
            const int i = model_ranges[r].rows[k];
            const double part = fabs(t->off[i]) / (t->noise[i] + MODEL_TOLERANCE * own);
            if (!(part <= worst)) worst = isnan(part) ? INFINITY : part;
        }
    }
    return worst;
}

/* 1 if forces balance the loads along all motions. */
static inline int model_resting(model_together *t) {
#if MODEL_FLOATS
    double left[MODEL_MOTIONS], sizes[MODEL_MOTIONS], most = 0;
    if (!t->floats) return 1;
    memcpy(t->room->forces, t->forces, MODEL_CONDITIONS * sizeof(double));
    model_balance(t->room, left, sizes, 0);
    for (int j = 0; j < MODEL_MOTIONS; j++) most = fmax(most, sizes[j]);
    for (int j = 0; j < MODEL_MOTIONS; j++)
        if (!(fabs(left[j]) <= MODEL_RESTS * most)) return 0;
#endif
    (void)t;
    return 1;
}

/* The next forces and motions; 0 if they are undetermined. Rows that read no force but their own are known at once, as those of
   open contacts are. */
static inline int model_next(model_together *t) {
    const int m = MODEL_CONDITIONS;
    double *a = t->room->factored, *x = t->x;
    unsigned char known[MODEL_CONDITIONS];
    int left = 0, size;
    for (int i = 0; i < m; i++) known[i] = t->on_slack[i] == 0 && t->on_forces[i] != 0;
#if MODEL_RUBS
    for (int k = 0; k < MODEL_TANGENTS; k++)
        if (t->follows[k] != 0 || t->mixed[k] != 0) known[model_tangential[k]] = 0;
#endif
    for (int i = 0; i < m; i++)
        if (known[i]) t->forces[i] = t->right[i] / t->on_forces[i];
        else t->place[left++] = i;
    size = left;
#if MODEL_FLOATS
    if (t->floats) size += MODEL_MOTIONS;
#endif
    memset(a, 0, sizeof(double) * size * size);
    for (int r = 0; r < left; r++) {
        const int i = t->place[r];
        if (t->on_slack[i] != 0) model_add_slack(t, a + r * size, t->on_slack[i], i, left);
        a[r * size + r] += t->on_forces[i];
        x[r] = t->right[i] - (t->on_slack[i] != 0 ? t->on_slack[i] * model_slack_of_known(t, known, i) : 0);
    }
#if MODEL_RUBS
    model_add_friction(t, a, x, known, left, size);
#endif
#if MODEL_FLOATS
    for (int j = 0; j < size - left; j++) {
        x[left + j] = t->room->driving[j];
        for (int i = 0; i < m; i++)
            if (known[i]) x[left + j] -= model_taken[i * MODEL_MOTIONS + j] * t->forces[i];
        for (int b = 0; b < left; b++) a[(left + j) * size + b] = model_taken[t->place[b] * MODEL_MOTIONS + j];
    }
#endif
    if (!model_factored(a, size, t->room->pivots, x)) return 0;
    for (int r = 0; r < left; r++) t->forces[t->place[r]] = x[r];
    for (int j = 0; j < size - left; j++) t->motions[j] = x[left + j];
    return 1;
}

static inline void model_slacken(model_together *t) {
    const int m = MODEL_CONDITIONS;
    for (int i = 0; i < m; i++) {
        t->slack[i] = t->free[i];
        for (int j = 0; j < m; j++) t->slack[i] += t->schur[i * m + j] * t->forces[j];
#if MODEL_FLOATS
        if (t->floats) t->slack[i] -= model_taken_by(i, t->motions);
#endif
    }
}

/* Newton's method from the forces at the start, with one way to choose statuses; 0 without convergence. */
static inline int model_attempted(model_together *t, const double *motions, int attempt) {
    const int m = MODEL_CONDITIONS;
    double least = INFINITY;
    memcpy(t->forces, t->start, m * sizeof(double));
    memcpy(t->motions, motions, MODEL_MOTIONS * sizeof(double));
    for (int iteration = 0; iteration <= MODEL_ITERATED; iteration++) {
        model_slacken(t), model_linear(t, t->stiffness, attempt);
        const double worst = model_worst(t);
        if (worst <= 1 && model_resting(t)) return 1;
        if (iteration == MODEL_ITERATED || !isfinite(worst)) return 0;
        for (int k = 0; k < iteration; k++)
            if (!memcmp(t->seen + (size_t)m * k, t->status, m) && !(worst < 0.5 * least)) return 0;
        memcpy(t->seen + (size_t)m * iteration, t->status, m);
        least = fmin(least, worst);
        if (!model_next(t)) return 0;
    }
    return 0;
}

static inline int model_newtons(model_together *t, const double *motions) {
    for (int attempt = 0; attempt < MODEL_ATTEMPTS; attempt++)
        if (model_attempted(t, motions, attempt)) return 1;
    return 0;
}

/* Forces of bodies that are held: by Newton's method, and if it does not converge, with projections before it. */
static inline int model_found(model_together *t) {
    static const int projections[] = {30, 100, 300, 1000, 3000, 10000};
    const int m = MODEL_CONDITIONS;
    double none[MODEL_MOTIONS + 1], c[MODEL_CONDITIONS], most = 0;
    memset(none, 0, sizeof none);
    if (model_newtons(t, none)) return 1;
    for (int i = 0; i < m; i++) {
        double sum = 0; /* no norm of S is smaller than its largest eigenvalue */
        for (int j = 0; j < m; j++) sum += fabs(t->schur[i * m + j]);
        most = fmax(most, sum);
    }
    for (int i = 0; i < m; i++) c[i] = 1.9 / most;
    for (size_t round = 0; round < sizeof projections / sizeof *projections; round++) {
        for (int i = 0; i < m; i++) t->forces[i] = isfinite(t->start[i]) ? t->start[i] : 0;
        for (int k = 0; k < projections[round]; k++) {
            model_slacken(t), model_linear(t, c, 1);
            for (int i = 0; i < m; i++) t->forces[i] -= t->off[i];
        }
        memcpy(t->start, t->forces, m * sizeof(double));
        if (model_newtons(t, none)) return 1;
    }
    return 0;
}

static inline void model_set_stiff(model_together *t) {
    const int m = MODEL_CONDITIONS;
    double sum = 0;
    int count = 0;
    for (int i = 0; i < m; i++) {
        const double own = fabs(t->schur[i * m + i]);
        if (own > 0) sum += own, count++;
    }
    for (int i = 0; i < m; i++) {
        const double own = fabs(t->schur[i * m + i]);
        t->stiffness[i] = 1 / (own > 0 ? own : count ? sum / count : 1);
    }
}

#if MODEL_FLOATS
/* S and the free slack of bodies on springs with given ends, or with motions as unknowns. */
static inline void model_on(model_together *t, double weak, const double *ends) {
    const int m = MODEL_CONDITIONS, r = MODEL_MOTIONS;
    double offset[MODEL_MOTIONS];
    for (int j = 0; j < r; j++) offset[j] = ends ? ends[j] + model_pushes[j] * weak * t->room->driving[j] : 0;
    for (int i = 0; i < m; i++) {
        t->free[i] = t->bare[i] - model_taken_by(i, offset);
        for (int k = 0; k < m; k++) {
            t->schur[i * m + k] = t->rigid[i * m + k];
            for (int j = 0; j < r && ends; j++)
                t->schur[i * m + k] += model_taken[i * r + j] * model_pushes[j] * weak * model_taken[k * r + j];
        }
    }
    t->floats = !ends, model_set_stiff(t);
}

/* Bodies that contact alone holds: with the motions as unknowns, or on weak springs whose ends move until they bear nothing. */
static inline int model_found_free(model_together *t) {
    static const double weakness[] = {1e3, 1e5, 1e7, 1e9};
    const int m = MODEL_CONDITIONS;
    double ends[MODEL_MOTIONS], left[MODEL_MOTIONS], sizes[MODEL_MOTIONS];
    memset(ends, 0, sizeof ends);
    memcpy(t->rigid, t->schur, sizeof(double) * m * m), memcpy(t->bare, t->free, m * sizeof(double));
    model_on(t, 0, NULL);
    if (model_newtons(t, ends)) return 1;
    for (size_t s = 0; s < sizeof weakness / sizeof *weakness; s++)
        for (int step = 0; step < MODEL_SPRINGS; step++) {
            double most = 0;
            int close = 1;
            model_on(t, weakness[s], ends);
            if (!model_found(t)) return 0;
            memcpy(t->start, t->forces, m * sizeof(double)), memcpy(t->room->forces, t->forces, m * sizeof(double));
            model_balance(t->room, left, sizes, 0);
            for (int j = 0; j < MODEL_MOTIONS; j++) most = fmax(most, sizes[j]);
            for (int j = 0; j < MODEL_MOTIONS; j++) close = close && fabs(left[j]) <= MODEL_RESTS * most;
            for (int j = 0; j < MODEL_MOTIONS; j++) ends[j] += model_pushes[j] * weakness[s] * left[j];
            if (close) {
                model_slacken(t), memcpy(t->motions, ends, sizeof ends);
                return 1;
            }
            model_on(t, 0, NULL);
            if (model_newtons(t, ends)) return 1;
        }
    return 0;
}
#endif

/* Forces at a point, whose S and free slack the room has, from those at the start and from a memory, NULL without any; 0
   without an answer. */
static inline int model_prepared(model_together *t, const double *point, const double *memory, double seconds) {
    const int m = MODEL_CONDITIONS;
    t->memory = memory, t->seconds = seconds;
    memcpy(t->free, t->room->slack, m * sizeof(double));
#if MODEL_RUBS
    if (!model_set_laws(t->slider, point)) return 0;
    model_set_softened(t->slider, t->room->schur);
    memcpy(t->schur, t->slider->schur, sizeof(double) * m * m);
#else
    memcpy(t->schur, t->room->schur, sizeof(double) * m * m);
#endif
    for (int r = 0; r < MODEL_RANGES; r++) {
        const model_range *range = &model_ranges[r];
        for (int k = 0; k < range->formulas_count; k++) t->values[range->first_formula + k] = MODEL_AT(range->formulas[k], point);
        for (int k = 0; k < range->count && range->law > 0; k++) {
            const model_own own = model_own_of(t, range, k);
            t->free[range->rows[k]] += model_law_shift(range->law, &own);
        }
    }
    for (int i = 0; i < m; i++)
        if (!isfinite(t->free[i])) return 0;
    model_set_stiff(t);
    return 1;
}

static inline int model_settled(model_together *t) {
#if MODEL_FLOATS
    return model_found_free(t);
#else
    return model_found(t);
#endif
}

static inline int model_finite(const model_work *w) {
    for (int i = 0; i < MODEL_CONDITIONS; i++)
        if (!isfinite(w->forces[i])) return 0;
    return 1;
}

#if !MODEL_PATHS
/* Forces, and motions, at a point whose S and free slack the room has; 0 without an answer. */
static inline int model_answered_together(model_work *w, const double *point) {
    model_together *t = w->together;
    if (!t && !(t = w->together = model_together_new(w))) return 0;
    memset(t->start, 0, MODEL_CONDITIONS * sizeof(double));
    if (!model_prepared(t, point, NULL, NAN) || !model_settled(t)) return 0;
    memcpy(w->forces, t->forces, MODEL_CONDITIONS * sizeof(double));
    memcpy(w->active, t->active, MODEL_CONDITIONS);
#if MODEL_FLOATS
    memcpy(w->motions, t->motions, MODEL_MOTIONS * sizeof(double));
#endif
    return model_finite(w);
}
#else
typedef struct {
    model_work *room;
    model_together *together;
    model_state *state, *pool;
    double *largest; /* norm of the forces of each range so far */
    double seconds, dt; /* of an increment, or of the first load; of the part that is solved */
    int begun;
} model_path;

static inline void model_path_free(model_path *p) {
    if (!p) return;
    for (int k = 0; p->pool && k < MODEL_POOL; k++) free(p->pool[k].block);
    if (p->state) free(p->state->block);
    model_together_free(p->together), model_free(p->room), free(p->state), free(p->pool), free(p->largest), free(p);
}

/* A path that has not begun; NULL without memory. */
static inline model_path *model_path_new(void) {
    model_path *p = calloc(1, sizeof *p);
    if (!p) return NULL;
    p->room = model_new(), p->together = model_together_new(p->room), p->state = calloc(1, sizeof *p->state);
    p->pool = calloc(MODEL_POOL, sizeof *p->pool), p->largest = calloc(MODEL_RANGES, sizeof(double)), p->seconds = 1;
    int all = p->room && p->together && p->state && p->pool && p->largest && model_state_new(p->state);
    for (int k = 0; all && k < MODEL_POOL; k++) all = model_state_new(&p->pool[k]);
    if (all) return p;
    model_path_free(p);
    return NULL;
}

/* Memory of the laws after an increment. */
static inline void model_keep(const model_together *t, model_state *after) {
    for (int r = 0; r < MODEL_RANGES; r++) {
        const model_range *range = &model_ranges[r];
        for (int k = 0; k < range->count && range->law > 0; k++) {
            const model_own own = model_own_of(t, range, k);
            const int i = range->rows[k];
            model_law_after(range->law, &own, t->forces[i], t->slack[i], t->active[i], after->memory + range->first + k * range->memory);
        }
    }
}

/* State after an increment of some seconds to a point; 0 if it does not converge. */
static inline int model_increment(model_path *p, const model_state *before, const double *point, model_state *after) {
    model_together *t = p->together;
    const int m = MODEL_CONDITIONS;
    double energy = 0;
    if (!model_set_contact(p->room, point)) return 0;
    p->room->started = 1; /* S is computed */
    memcpy(t->start, before->forces, m * sizeof(double));
    if (!model_prepared(t, point, before->memory, p->dt)) return 0;
#if MODEL_RUBS
    for (int k = 0; k < MODEL_TANGENTS; k++) t->free[model_tangential[k]] -= before->slip.position[k];
#endif
    if (!model_settled(t)) return 0;
    memcpy(after->point, point, MODEL_PARAMETERS * sizeof(double));
    memcpy(after->forces, t->forces, m * sizeof(double));
    memcpy(after->motions, t->motions, MODEL_MOTIONS * sizeof(double));
    for (int i = 0; i < m; i++)
        for (int j = 0; j < m; j++) energy += 0.5 * t->forces[i] * p->room->schur[i * m + j] * t->forces[j];
    *after->energy = fmax(*before->energy, energy), *after->time = *before->time + p->dt;
    model_keep(t, after);
#if MODEL_RUBS
    model_keep_slip(t, &before->slip, &after->slip);
#endif
    return 1;
}

/* An increment of the seconds of the path, in halves if necessary. */
static inline int model_reached(model_path *p, const model_state *before, const double *point, model_state *after, int depth) {
    double middle[MODEL_PARAMETERS];
    model_state *half = &p->pool[3 * depth];
    p->dt = ldexp(p->seconds, -depth);
    if (model_increment(p, before, point, after)) return 1;
    if (depth == MODEL_HALVED) return 0;
    model_between(before->point, point, 0.5, middle);
    return model_reached(p, before, middle, half, depth + 1) && model_reached(p, half, point, after, depth + 1);
}

static inline double model_norm_of(const model_range *range, const double *forces, const double *others) {
    double square = 0;
    for (int k = 0; k < range->count; k++) {
        const double own = forces[range->rows[k]] - (others ? others[range->rows[k]] : 0);
        square += own * own;
    }
    return sqrt(square);
}

/* An increment that counts in the denominators of errors, also if the path discards it. */
static inline int model_tried(model_path *p, const model_state *before, const double *point, double dt, model_state *after) {
    p->dt = dt;
    if (!model_increment(p, before, point, after)) return 0;
    for (int r = 0; r < MODEL_RANGES; r++) p->largest[r] = fmax(p->largest[r], model_norm_of(&model_ranges[r], after->forces, NULL));
    return 1;
}

/* Error estimate by halving an increment: forces of a range over its largest, and what friction measures. */
static inline double model_off(const model_path *p, const model_state *before, const model_state *half,
                               const model_state *second, const model_state *whole) {
    double worst = 0, most = 0;
    for (int r = 0; r < MODEL_RANGES; r++) most = fmax(most, p->largest[r]);
    for (int r = 0; r < MODEL_RANGES; r++) {
        const double own = fmax(p->largest[r], MODEL_WEAKEST * most), size = own > 0 ? own : 1;
        double off = model_norm_of(&model_ranges[r], second->forces, whole->forces) / size;
#if MODEL_RUBS
        if (model_ranges[r].law < 0) off = model_off_friction(before, half, second, whole, off, size);
#endif
        worst = fmax(worst, off);
    }
    (void)before, (void)half;
    return worst;
}

/* An increment of proportional loading, halved until that changes little, as in models/histories/increments.py. */
static inline int model_careful(model_path *p, const model_state *before, const double *point, double dt, model_state *after,
                                int depth) {
    double middle[MODEL_PARAMETERS];
    model_state *half = &p->pool[3 * depth], *whole = half + 1, *second = half + 2;
    const int single = model_tried(p, before, point, dt, whole);
    if (depth >= (single ? MODEL_CUTS : MODEL_HALVED)) {
        if (single) model_copy(after, whole), MODEL_REACHED(whole);
        return single;
    }
    model_between(before->point, point, 0.5, middle);
    if (model_tried(p, before, middle, dt / 2, half) && single && model_tried(p, half, point, dt / 2, second) &&
        (model_off(p, before, half, second, whole) <= MODEL_CONVERGED || depth + 1 >= MODEL_CUTS)) {
        MODEL_REACHED(half), MODEL_REACHED(second);
        model_copy(after, second);
        return 1;
    }
    return model_careful(p, before, middle, dt / 2, half, depth + 1) && model_careful(p, half, point, dt / 2, after, depth + 1);
}

static inline int model_told(model_path *p, double *forces, double *outputs) {
    model_work *w = p->room;
    model_set_theta(w, p->state->point);
    memcpy(w->forces, p->state->forces, MODEL_CONDITIONS * sizeof(double));
#if MODEL_FLOATS
    memcpy(w->motions, p->state->motions, MODEL_MOTIONS * sizeof(double));
#endif
    if (forces) memcpy(forces, w->forces, MODEL_CONDITIONS * sizeof(double));
    if (outputs) model_read(w, outputs);
    return MODEL_DONE;
}

/* Begin at rest, at the point of the box nearest to zero, with the moduli and laws of a point. */
static inline int model_rest(model_path *p, const double *point) {
    memset(p->state->block, 0, p->state->size), memset(p->largest, 0, MODEL_RANGES * sizeof(double));
    model_start(point, p->state->point);
    p->begun = 0;
    if (!model_stays(point)) return MODEL_OUTSIDE;
    if (!model_set_contact(p->room, p->state->point)) return MODEL_NO_ANSWER;
    p->room->started = 1;
#if MODEL_RUBS
    if (!model_slip_at_rest(p->together->slider, p->room->slack, p->state->point, &p->state->slip)) return MODEL_NO_ANSWER;
#endif
    p->begun = 1;
    return MODEL_DONE;
}

/* Begin at rest, with proportional loading up to a point, within the seconds of the path. Forces, (MODEL_CONDITIONS), and
   outputs, (MODEL_OUTPUTS), may be NULL. */
static inline int model_begin(model_path *p, const double *point, double *forces, double *outputs) {
    double from[MODEL_PARAMETERS], next[MODEL_PARAMETERS];
    model_state *reached = &p->pool[MODEL_LAST];
    if (!model_inside(point)) return MODEL_OUTSIDE;
    if (model_rest(p, point)) return MODEL_NO_ANSWER;
    memcpy(from, p->state->point, sizeof from);
    for (int step = 1; step <= MODEL_FEWEST; step++) {
        model_between(from, point, (double)step / MODEL_FEWEST, next);
        if (!model_careful(p, p->state, step == MODEL_FEWEST ? point : next, p->seconds / MODEL_FEWEST, reached, 0)) {
            p->begun = 0;
            return MODEL_NO_ANSWER;
        }
        model_copy(p->state, reached);
    }
    return model_told(p, forces, outputs);
}
#endif
