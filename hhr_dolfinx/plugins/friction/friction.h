
/* Increments with friction, with one tangent per contact, or two in space: statuses and directions by a semi-smooth Newton
   method; if it does not converge, sweeps over single contacts improve the forces. As in friction.js. */
#define MODEL_NEWTON 40
#define MODEL_GIVES 1e-4
#define MODEL_HALVED 6
#define MODEL_FEWEST 4
#define MODEL_CUTS 12
#define MODEL_SETTLED 1e-3
#define MODEL_WORK_LEAST 1e-3
#define MODEL_APART 1e-9
#define MODEL_LAST (3 * (MODEL_CUTS + 1)) /* index of the end of an increment */

/* State of contacts: sticking position, length of slip, its work and its wear. */
typedef struct {
    double point[MODEL_PARAMETERS], forces[MODEL_CONDITIONS], position[MODEL_TANGENTS], slipped[MODEL_CONTACTS];
    double work[MODEL_CONTACTS], wear[MODEL_CONTACTS], pressure[MODEL_CONTACTS], bound[MODEL_CONTACTS], gap[MODEL_CONTACTS];
    double energy;
    unsigned char statuses[MODEL_CONTACTS]; /* 0 open, 1 stick, 2 slip */
} model_state;

/* An unknown: its rows, its test, and its diagonal term. */
typedef struct {
    int rows[3], tests[2], count, tested;
    double shares[3], weights[2], own;
} model_column;

typedef struct {
    model_work *room;
    model_state *state, *pool;
    model_column *columns;
    double *schur, *slack, *stiffness, *y, *start, *forces, *left, *known, *x, *ways; /* ways: slip directions along rows */
    double coefficient[MODEL_CONTACTS], limit[MODEL_CONTACTS], shrunk[MODEL_CONTACTS], probe, largest, energy; /* the last two are denominators of errors */
    int *place;
    unsigned char *at, *pressing, *seen; /* at: rows act, are at their limit, slip: 0, 1 or, backwards, 2 */
    int begun;
} model_path;

static inline void model_path_free(model_path *p) {
    if (!p) return;
    model_free(p->room), free(p->state), free(p->pool), free(p->schur), free(p->slack), free(p->stiffness), free(p->y);
    free(p->start), free(p->forces), free(p->left), free(p->known), free(p->x), free(p->ways), free(p->columns), free(p->place), free(p->at);
    free(p->pressing), free(p->seen), free(p);
}

/* A path that has not begun; NULL without memory. */
static inline model_path *model_path_new(void) {
    const size_t m = MODEL_CONDITIONS;
    model_path *p = calloc(1, sizeof *p);
    if (!p) return NULL;
    p->room = model_new(), p->state = calloc(1, sizeof *p->state);
    p->pool = calloc(3 * (MODEL_CUTS + 2), sizeof *p->pool), p->schur = malloc(m * m * sizeof(double));
    double **rows[] = {&p->slack, &p->stiffness, &p->y, &p->start, &p->forces, &p->left, &p->known, &p->x, &p->ways};
    int all = p->room && p->state && p->pool && p->schur;
    for (size_t k = 0; k < sizeof rows / sizeof *rows; k++) all = (*rows[k] = calloc(m, sizeof(double))) && all;
    p->columns = malloc(m * sizeof *p->columns), p->place = malloc(m * sizeof(int)), p->at = malloc(3 * m), p->pressing = malloc(m);
    p->seen = malloc(3 * m * (MODEL_NEWTON + 1));
    if (all && p->columns && p->place && p->at && p->pressing && p->seen) {
        memset(p->pressing, 1, m);
        for (int k = 0; k < MODEL_TANGENTS; k++) p->pressing[model_tangential[k]] = 0;
        return p;
    }
    model_path_free(p);
    return NULL;
}

static inline double model_most(const double *values) {
    double most = 0;
    for (int i = 0; i < MODEL_CONDITIONS; i++) most = fmax(most, fabs(values[i]));
    return most;
}

static inline double model_bounded(const model_path *p, int contact, double force) {
    const double carried = isinf(p->coefficient[contact]) ? INFINITY : p->coefficient[contact] * fmax(force, 0);
    return fmin(carried, p->limit[contact]);
}

/* Slack under forces. */
static inline void model_leave(const model_path *p, const double *forces, double *left) {
    const int m = MODEL_CONDITIONS;
    memcpy(left, p->slack, m * sizeof(double));
    for (int j = 0; j < m; j++)
        if (forces[j] != 0)
            for (int i = 0; i < m; i++) left[i] += p->schur[i * m + j] * forces[j];
}

static inline double model_share(double bound, double size) { return size > bound ? bound / size : 1; }

/* Statuses from forces and slacks; returns the residual. */
static inline double model_projected(model_path *p, double probe) {
    const int m = MODEL_CONDITIONS;
    unsigned char *acting = p->at, *limited = p->at + m, *slips = p->at + 2 * m;
    double worst = 0;
    memset(p->at, 0, 3 * (size_t)m);
    for (int i = 0; i < m; i++) p->y[i] = p->forces[i] - p->stiffness[i] * p->left[i];
    for (int i = 0; i < m; i++)
        if (p->pressing[i]) {
            acting[i] = p->y[i] > 0;
            worst = fmax(worst, fabs(p->forces[i] - fmax(p->y[i], 0)));
        }
    p->probe = probe;
    for (int contact = 0; contact < MODEL_CONTACTS; contact++) {
        const int normal = model_normal[contact];
        const double bound = model_bounded(p, contact, p->y[normal]);
        double size = 0, pushes = 0;
        for (int k = model_along[contact]; k < model_along[contact + 1]; k++) {
            const int row = model_tangential[k];
            p->ways[row] = p->forces[row] + probe * (p->y[row] - p->forces[row]);
            size = hypot(size, p->y[row]), pushes = hypot(pushes, p->ways[row]);
        }
        const double share = model_share(bound, size);
        p->shrunk[contact] = model_share(bound, pushes);
        for (int k = model_along[contact]; k < model_along[contact + 1]; k++) {
            const int row = model_tangential[k];
            worst = fmax(worst, fabs(p->forces[row] - share * p->y[row]));
            acting[row] = acting[normal] || bound > 0;
            limited[row] = bound >= p->limit[contact];
            slips[row] = acting[row] && pushes > bound ? (p->ways[row] >= 0 ? 1 : 2) : 0;
            p->ways[row] = slips[row] ? p->ways[row] / pushes : 0;
        }
    }
    return worst;
}

static inline model_column *model_unknown(model_path *p, int *n, int row) {
    model_column *column = &p->columns[(*n)++];
    memset(column, 0, sizeof *column);
    column->rows[0] = column->tests[0] = row;
    column->shares[0] = column->weights[0] = column->count = column->tested = 1;
    return column;
}

/* Unknowns for given statuses; a force that slips at its limit is known. Other slipping forces are proportional to the
   pressure; in space the force across, along e, is an unknown too: (1 - s) x + s p c e slack = 0 with s = shrunk. */
static inline int model_unknowns(model_path *p) {
    const int m = MODEL_CONDITIONS;
    const unsigned char *acting = p->at, *limited = p->at + m, *slips = p->at + 2 * m;
    int n = 0;
    for (int i = 0; i < m; i++) {
        p->place[i] = -1, p->known[i] = 0;
        if (acting[i] && !slips[i]) p->place[i] = n, model_unknown(p, &n, i);
    }
    for (int contact = 0; contact < MODEL_CONTACTS; contact++) {
        const int first = model_along[contact], count = model_along[contact + 1] - first, place = p->place[model_normal[contact]];
        if (!count || !slips[model_tangential[first]]) continue;
        for (int k = first; k < first + count; k++) {
            const int row = model_tangential[k];
            if (limited[row]) {
                p->known[row] = p->ways[row] * p->limit[contact];
            } else if (place >= 0) {
                model_column *leader = &p->columns[place];
                leader->rows[leader->count] = row;
                leader->shares[leader->count++] = p->ways[row] * p->coefficient[contact];
            }
        }
        if (count < 2) continue;
        const int one = model_tangential[first], two = model_tangential[first + 1];
        const double tested = p->shrunk[contact] * p->probe * p->stiffness[one];
        model_column *across = model_unknown(p, &n, one);
        across->rows[1] = across->tests[1] = two, across->count = across->tested = 2;
        across->shares[0] = -p->ways[two], across->shares[1] = p->ways[one];
        across->weights[0] = tested * across->shares[0], across->weights[1] = tested * across->shares[1];
        across->own = 1 - p->shrunk[contact];
    }
    return n;
}

/* Forces for given statuses; 0 if they are undetermined. */
static inline int model_on_statuses(model_path *p) {
    const int m = MODEL_CONDITIONS, n = model_unknowns(p);
    double *a = p->room->factored, *pushed = p->y;
    model_leave(p, p->known, pushed);
    for (int r = 0; r < n; r++) {
        const model_column *tests = &p->columns[r];
        p->x[r] = 0;
        for (int c = 0; c < n; c++) a[r * n + c] = c == r ? tests->own : 0;
        for (int t = 0; t < tests->tested; t++) {
            const double *row = p->schur + tests->tests[t] * m;
            p->x[r] -= tests->weights[t] * pushed[tests->tests[t]];
            for (int c = 0; c < n; c++)
                for (int k = 0; k < p->columns[c].count; k++)
                    a[r * n + c] += tests->weights[t] * p->columns[c].shares[k] * row[p->columns[c].rows[k]];
        }
    }
    if (!model_factored(a, n, p->room->pivots, p->x)) return 0;
    memcpy(p->forces, p->known, m * sizeof(double));
    for (int c = 0; c < n; c++)
        for (int k = 0; k < p->columns[c].count; k++) p->forces[p->columns[c].rows[k]] += p->columns[c].shares[k] * p->x[c];
    for (int i = 0; i < m; i++)
        if (!isfinite(p->forces[i])) return 0;
    return 1;
}

/* Newton's method from initial forces; stores forces and slacks if it converges, else returns 0. */
static inline int model_iterated(model_path *p, const double *start, double probe) {
    const int m = MODEL_CONDITIONS;
    const unsigned char *acting = p->at, *slips = p->at + 2 * m;
    double noise = 0, least = INFINITY;
    memcpy(p->forces, start, m * sizeof(double));
    for (int i = 0; i < m; i++) noise = fmax(noise, fabs(p->stiffness[i] * p->slack[i]));
    for (int iteration = 0; iteration <= MODEL_NEWTON; iteration++) {
        model_leave(p, p->forces, p->left);
        const double worst = model_projected(p, probe);
        if (worst <= MODEL_TOLERANCE * model_most(p->forces) + MODEL_ROUND_OFF * noise) {
            for (int i = 0; i < m; i++) {
                if (!acting[i]) p->forces[i] = 0;
                p->x[i] = p->left[i] - p->slack[i]; /* response to the forces */
                if (acting[i] && !slips[i]) p->left[i] = 0;
            }
            return 1;
        }
        for (int k = 0; k < iteration; k++)
            if (!memcmp(p->seen + 3 * (size_t)m * k, p->at, 3 * (size_t)m) && !(worst < 0.5 * least)) return 0;
        memcpy(p->seen + 3 * (size_t)m * iteration, p->at, 3 * (size_t)m);
        least = fmin(least, worst);
        if (!model_on_statuses(p)) return 0;
    }
    return 0;
}

static inline double model_moved(const model_path *p, const double *forces, int i) {
    double left = p->slack[i];
    for (int j = 0; j < MODEL_CONDITIONS; j++) left += p->schur[i * MODEL_CONDITIONS + j] * forces[j];
    return forces[i] - p->stiffness[i] * left;
}

/* Projections of single contacts, one after another, in place. */
static inline void model_swept(const model_path *p, double *forces, int count) {
    for (int sweep = 0; sweep < count; sweep++) {
        for (int i = 0; i < MODEL_CONDITIONS; i++)
            if (p->pressing[i]) forces[i] = fmax(0, model_moved(p, forces, i));
        for (int contact = 0; contact < MODEL_CONTACTS; contact++) {
            const int first = model_along[contact], count = model_along[contact + 1] - first;
            double moved[2] = {0, 0};
            for (int k = 0; k < count; k++) moved[k] = model_moved(p, forces, model_tangential[first + k]);
            const double share = model_share(model_bounded(p, contact, forces[model_normal[contact]]), hypot(moved[0], moved[1]));
            for (int k = 0; k < count; k++) forces[model_tangential[first + k]] = share * moved[k];
        }
    }
}

static inline int model_settles(model_path *p) {
    static const int sweeps[] = {0, 10, 30, 100, 300, 1000, 3000};
    static const double probes[] = {0.2, 1, 0.01};
    for (size_t s = 0; s < sizeof sweeps / sizeof *sweeps; s++) {
        model_swept(p, p->start, sweeps[s]);
        for (size_t k = 0; k < sizeof probes / sizeof *probes; k++)
            if (model_iterated(p, p->start, probes[k])) return 1;
    }
    return 0;
}

/* State after an increment: bounds and pressures along a slip are the means of both ends. */
static inline void model_remember(const model_path *p, const model_state *before, const double *point, model_state *after) {
    const int m = MODEL_CONDITIONS;
    const unsigned char *acting = p->at, *slips = p->at + 2 * m;
    double slipped[MODEL_CONTACTS] = {0};
    unsigned char slides[MODEL_CONTACTS] = {0};
    memcpy(after->point, point, sizeof after->point);
    memcpy(after->forces, p->forces, sizeof after->forces);
    after->energy = 0;
    for (int i = 0; i < m; i++) after->energy += 0.5 * p->forces[i] * p->x[i];
    for (int k = 0; k < MODEL_TANGENTS; k++) {
        const int row = model_tangential[k], contact = model_owner[k];
        after->position[k] = before->position[k] + p->left[row];
        slipped[contact] = hypot(slipped[contact], p->left[row]);
        slides[contact] = slips[row] != 0;
    }
    for (int k = 0; k < MODEL_CONTACTS; k++) {
        const int row = model_normal[k];
        const double pressure = fmax(p->forces[row], 0), bound = model_bounded(p, k, p->forces[row]);
        const double closed = 0.5 * ((before->pressure[k] > 0) + (pressure > 0)), mean = 0.5 * (before->pressure[k] + pressure);
        after->gap[k] = p->left[row], after->pressure[k] = pressure, after->bound[k] = bound;
        after->slipped[k] = before->slipped[k] + slipped[k] * closed;
        after->work[k] = before->work[k] + 0.5 * (before->bound[k] + bound) * slipped[k];
        after->wear[k] = before->wear[k] + (model_area[k] > 0 ? mean / model_area[k] : 0) * slipped[k];
        after->statuses[k] = !acting[row] ? 0 : slides[k] ? 2 : 1;
    }
}

/* State after an increment to a point; 0 if it does not converge. */
static inline int model_increment(model_path *p, const model_state *before, const double *point, model_state *after) {
    const int m = MODEL_CONDITIONS;
    if (!model_set_contact(p->room, point)) return 0;
    p->room->started = 1; /* S is computed */
    memcpy(p->slack, p->room->slack, m * sizeof(double));
    memcpy(p->schur, p->room->schur, m * m * sizeof(double));
    memcpy(p->start, before->forces, m * sizeof(double));
    for (int k = 0; k < MODEL_TANGENTS; k++) p->slack[model_tangential[k]] -= before->position[k];
    for (int k = 0; k < MODEL_TWICE; k++) { /* rows that act on no unknown are regularised by a part of the compliance of their pressure */
        int own = 0;
        while (model_tangential[own] != model_twice[k]) own++;
        const int row = model_twice[k], pressure = model_normal[model_owner[own]];
        const double compliance = p->schur[row * m + row];
        p->schur[row * m + row] += MODEL_GIVES * (compliance > 0 ? compliance : p->schur[pressure * m + pressure]);
    }
    for (int i = 0; i < m; i++) p->stiffness[i] = 1 / fabs(p->schur[i * m + i]);
    for (int k = 0; k < MODEL_CONTACTS; k++) /* the same for both directions of a contact: the projection is on a disc */
        if (model_along[k + 1] - model_along[k] == 2) {
            const int one = model_tangential[model_along[k]], two = model_tangential[model_along[k] + 1];
            p->stiffness[one] = p->stiffness[two] = fmin(p->stiffness[one], p->stiffness[two]);
        }
    for (int k = 0; k < MODEL_CONTACTS; k++) {
        const model_law *law = &model_laws[model_law_of[k]];
        p->coefficient[k] = law->coefficient ? law->coefficient(point) : INFINITY;
        p->limit[k] = law->limit ? law->limit(point) * model_area[k] : INFINITY;
        if (isnan(p->coefficient[k]) || isnan(p->limit[k])) return 0;
    }
    if (!model_settles(p)) return 0;
    model_remember(p, before, point, after);
    for (int k = 0; k < MODEL_TWICE; k++) { /* the energy is that of S without regularisation */
        const double force = p->forces[model_twice[k]];
        after->energy -= 0.5 * MODEL_GIVES * p->room->schur[model_twice[k] * m + model_twice[k]] * force * force;
    }
    return 1;
}

/* An increment, in halves if necessary. */
static inline int model_reached(model_path *p, const model_state *before, const double *point, model_state *after, int depth) {
    double middle[MODEL_PARAMETERS];
    model_state *half = &p->pool[3 * depth];
    if (model_increment(p, before, point, after)) return 1;
    if (depth == MODEL_HALVED) return 0;
    model_between(before->point, point, 0.5, middle);
    return model_reached(p, before, middle, half, depth + 1) && model_reached(p, half, point, after, depth + 1);
}

/* Squared sticking force of contacts that closed in this increment; its reference is the start of the increment. */
static inline double model_stuck(const model_state *before, const model_state *after) {
    double apart = 0, square = 0;
    for (int k = 0; k < MODEL_CONTACTS; k++) apart = fmax(apart, MODEL_APART * fabs(before->gap[k]));
    for (int k = 0; k < MODEL_TANGENTS; k++) {
        const int contact = model_owner[k];
        const double force = after->forces[model_tangential[k]];
        if (after->pressure[contact] > 0 && before->gap[contact] > apart) square += force * force;
    }
    return square;
}

/* Error estimate by halving an increment: forces over the largest, dissipated work over the total of the path. */
static inline double model_off(const model_path *p, const model_state *before, const model_state *half,
                               const model_state *second, const model_state *whole) {
    double change = 0, work = 0, other = 0;
    for (int i = 0; i < MODEL_CONDITIONS; i++)
        change += (second->forces[i] - whole->forces[i]) * (second->forces[i] - whole->forces[i]);
    for (int k = 0; k < MODEL_CONTACTS; k++) work += second->work[k], other += whole->work[k];
    const double forces = sqrt(change) + sqrt(model_stuck(before, half) + model_stuck(half, second));
    const double scale = work + MODEL_WORK_LEAST * p->energy;
    return fmax(forces / (p->largest > 0 ? p->largest : 1), fabs(work - other) / (scale > 0 ? scale : 1));
}

/* An increment that counts in the denominators of errors, also if the path discards it. */
static inline int model_tried(model_path *p, const model_state *before, const double *point, model_state *after) {
    double size = 0;
    if (!model_increment(p, before, point, after)) return 0;
    for (int i = 0; i < MODEL_CONDITIONS; i++) size += after->forces[i] * after->forces[i];
    p->largest = fmax(p->largest, sqrt(size));
    p->energy = fmax(p->energy, after->energy);
    return 1;
}

/* An increment of proportional loading, halved until that changes little, as in models/histories/sliding.py. */
static inline int model_careful(model_path *p, const model_state *before, const double *point, model_state *after, int depth) {
    double middle[MODEL_PARAMETERS];
    model_state *half = &p->pool[3 * depth], *whole = half + 1, *second = half + 2;
    const int single = model_tried(p, before, point, whole);
    if (depth >= (single ? MODEL_CUTS : MODEL_HALVED)) {
        if (single) *after = *whole;
        return single;
    }
    model_between(before->point, point, 0.5, middle);
    if (model_tried(p, before, middle, half) && single && model_tried(p, half, point, second) &&
        (model_off(p, before, half, second, whole) <= MODEL_SETTLED || depth + 1 >= MODEL_CUTS)) {
        *after = *second;
        return 1;
    }
    return model_careful(p, before, middle, half, depth + 1) && model_careful(p, half, point, after, depth + 1);
}

static inline int model_told(model_path *p, double *forces, double *outputs) {
    model_work *w = p->room;
    if (!model_set_contact(w, p->state->point)) return MODEL_NO_ANSWER;
    memcpy(w->forces, p->state->forces, MODEL_CONDITIONS * sizeof(double));
    if (forces) memcpy(forces, w->forces, MODEL_CONDITIONS * sizeof(double));
    if (outputs) model_read(w, outputs);
    return MODEL_DONE;
}

/* Begin at rest, at the point of the box nearest to zero, with the moduli and laws of a point. */
static inline int model_rest(model_path *p, const double *point) {
    double from[MODEL_PARAMETERS];
    model_start(point, from);
    memset(p->state, 0, sizeof *p->state);
    memcpy(p->state->point, from, sizeof from);
    p->begun = 0, p->largest = p->energy = 0;
    if (!model_stays(point)) return MODEL_OUTSIDE;
    if (!model_set_contact(p->room, from)) return MODEL_NO_ANSWER;
    p->room->started = 1;
    for (int k = 0; k < MODEL_CONTACTS; k++) p->state->gap[k] = p->room->slack[model_normal[k]];
    p->begun = 1;
    return MODEL_DONE;
}

/* Begin at rest, with proportional loading up to a point. Forces, (MODEL_CONDITIONS), and outputs, (MODEL_OUTPUTS), may be
   NULL. */
static inline int model_begin(model_path *p, const double *point, double *forces, double *outputs) {
    double from[MODEL_PARAMETERS], next[MODEL_PARAMETERS];
    model_state *reached = &p->pool[MODEL_LAST];
    if (!model_inside(point)) return MODEL_OUTSIDE;
    if (model_rest(p, point)) return MODEL_NO_ANSWER;
    memcpy(from, p->state->point, sizeof from);
    for (int step = 1; step <= MODEL_FEWEST; step++) {
        model_between(from, point, (double)step / MODEL_FEWEST, next);
        if (!model_careful(p, p->state, step == MODEL_FEWEST ? point : next, reached, 0)) {
            p->begun = 0;
            return MODEL_NO_ANSWER;
        }
        *p->state = *reached;
    }
    return model_told(p, forces, outputs);
}
