
/* Increments with friction, with one tangent per contact, or two in space: statuses and directions by a semi-smooth Newton
   method; if it does not converge, sweeps over single contacts improve the forces. Rigid motions of bodies that contact alone
   holds are unknowns too; if that fails, weak springs hold the bodies. As in plugins/friction/
   sliding_set.py. */
#define MODEL_RUBBED 40
#define MODEL_GIVES 1e-4
#define MODEL_BORDERED (MODEL_CONDITIONS + MODEL_MOTIONS)
#define MODEL_RESTING 1e-10 /* of bodies with rigid motions */
#define MODEL_HUGE 1e9

/* State of contacts: sticking position, length of slip, its work and its wear. */
typedef struct {
    double *position, *slipped, *work, *wear, *pressure, *bound, *gap;
    unsigned char *statuses; /* 0 open, 1 stick, 2 slip */
} model_slip;
#define MODEL_SLIP_ROWS(s) \
    {&s.position, MODEL_TANGENTS}, {&s.slipped, MODEL_CONTACTS}, {&s.work, MODEL_CONTACTS}, {&s.wear, MODEL_CONTACTS}, \
    {&s.pressure, MODEL_CONTACTS}, {&s.bound, MODEL_CONTACTS}, {&s.gap, MODEL_CONTACTS},
#define MODEL_SLIP_BYTES MODEL_CONTACTS

/* An unknown: its rows, its test, and its diagonal term. */
typedef struct {
    int rows[3], tests[2], count, tested;
    double shares[3], weights[2], own;
} model_column;

/* The contact problem of an increment. */
typedef struct {
    model_work *room;
    model_column *columns;
    double *block, *schur, *slack, *stiffness, *y, *start, *forces, *left, *known, *x;
    double *ways; /* slip directions along rows */
    double *kept; /* forces, and motions, that are near enough */
    double *coefficient, *limit, *shrunk, probe;
#if MODEL_FLOATS
    double *held, *bare, *motions; /* S and slack of bodies on springs, or without */
    int floats; /* motions are unknowns */
#endif
    int *place;
    unsigned char *at, *pressing, *seen; /* at: rows act, are at their limit, slip: 0, 1 or, backwards, 2 */
} model_slider;

static inline void model_slider_free(model_slider *p) {
    if (!p) return;
    free(p->block), free(p->columns), free(p->place), free(p->at), free(p->pressing), free(p->seen), free(p);
}

/* Work arrays that use those of a room; NULL without memory. */
static inline model_slider *model_slider_new(model_work *room) {
    const size_t m = MODEL_CONDITIONS, n = MODEL_BORDERED;
    model_slider *p = calloc(1, sizeof *p);
    if (!p) return NULL;
    const model_row rows[] = {{&p->schur, m * m}, {&p->slack, n}, {&p->stiffness, n}, {&p->y, n}, {&p->start, n}, {&p->forces, n},
                              {&p->left, n}, {&p->known, n}, {&p->x, n}, {&p->ways, n}, {&p->kept, n}, {&p->coefficient, MODEL_CONTACTS},
                              {&p->limit, MODEL_CONTACTS}, {&p->shrunk, MODEL_CONTACTS},
#if MODEL_FLOATS
                              {&p->held, m * m}, {&p->bare, m}, {&p->motions, MODEL_MOTIONS},
#endif
    };
    size_t size;
    p->room = room, p->block = model_block(MODEL_ROWS(rows), 0, &size);
    p->columns = malloc(m * sizeof *p->columns), p->place = malloc(m * sizeof(int)), p->at = malloc(3 * m), p->pressing = malloc(m);
    p->seen = malloc(3 * m * (MODEL_RUBBED + 1));
    if (room && p->block && p->columns && p->place && p->at && p->pressing && p->seen) {
        memset(p->pressing, 1, m);
        for (int k = 0; k < MODEL_TANGENTS; k++) p->pressing[model_tangential[k]] = 0;
        return p;
    }
    model_slider_free(p);
    return NULL;
}

static inline double model_most(const double *values) {
    double most = 0;
    for (int i = 0; i < MODEL_CONDITIONS; i++) most = fmax(most, fabs(values[i]));
    return most;
}

static inline double model_bounded(const model_slider *p, int contact, double force) {
    const double carried = isinf(p->coefficient[contact]) ? INFINITY : p->coefficient[contact] * fmax(force, 0);
    return fmin(carried, p->limit[contact]);
}

/* Slack under forces, and under motions. */
static inline void model_leave(const model_slider *p, const double *forces, double *left) {
    const int m = MODEL_CONDITIONS;
    memcpy(left, p->slack, m * sizeof(double));
    for (int j = 0; j < m; j++)
        if (forces[j] != 0)
            for (int i = 0; i < m; i++) left[i] += p->schur[i * m + j] * forces[j];
}

static inline void model_leave_moved(const model_slider *p, const double *forces, double *left) {
    model_leave(p, forces, left);
#if MODEL_FLOATS
    for (int i = 0; i < MODEL_CONDITIONS && p->floats; i++) left[i] -= model_taken_by(i, p->motions);
#endif
}

static inline double model_share(double bound, double size) { return size > bound ? bound / size : 1; }

/* Statuses from forces and slacks; returns the residual. */
static inline double model_projected(model_slider *p, double probe) {
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

static inline model_column *model_unknown(model_slider *p, int *n, int row) {
    model_column *column = &p->columns[(*n)++];
    memset(column, 0, sizeof *column);
    column->rows[0] = column->tests[0] = row;
    column->shares[0] = column->weights[0] = column->count = column->tested = 1;
    return column;
}

/* Unknowns for given statuses; a force that slips at its limit is known. Other slipping forces are proportional to the
   pressure; in space the force across, along e, is an unknown too: (1 - s) x + s p c e slack = 0 with s = shrunk. Beside
   motions rows of slacks and of forces have one scale. */
static inline int model_unknowns(model_slider *p) {
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
        double unit = 1;
#if MODEL_FLOATS
        if (p->floats) unit = MODEL_SOFTNESS;
#endif
        const double tested = unit * p->shrunk[contact] * p->probe * p->stiffness[one];
        model_column *across = model_unknown(p, &n, one);
        across->rows[1] = across->tests[1] = two, across->count = across->tested = 2;
        across->shares[0] = -p->ways[two], across->shares[1] = p->ways[one];
        across->weights[0] = tested * across->shares[0], across->weights[1] = tested * across->shares[1];
        across->own = unit * (1 - p->shrunk[contact]);
    }
    return n;
}

/* Factors the system of given statuses, and sets the forces that slip at limits; returns its size without motions, -1 if it
   is singular. */
static inline int model_on_statuses(model_slider *p) {
    const int m = MODEL_CONDITIONS, n = model_unknowns(p);
    double *a = p->room->factored;
    int size = n;
#if MODEL_FLOATS
    if (p->floats) size += MODEL_MOTIONS;
#endif
    memset(a, 0, sizeof(double) * size * size);
    for (int r = 0; r < n; r++) {
        const model_column *tests = &p->columns[r];
        a[r * size + r] = tests->own;
        for (int t = 0; t < tests->tested; t++) {
            const double *row = p->schur + tests->tests[t] * m;
            for (int c = 0; c < n; c++)
                for (int k = 0; k < p->columns[c].count; k++)
                    a[r * size + c] += tests->weights[t] * p->columns[c].shares[k] * row[p->columns[c].rows[k]];
        }
    }
#if MODEL_FLOATS
    for (int j = 0; j < size - n; j++) /* effect of the motions, in their units, and the balance along them */
        for (int r = 0; r < n; r++) {
            const model_column *own = &p->columns[r];
            for (int t = 0; t < own->tested; t++)
                a[r * size + n + j] -= own->weights[t] * model_taken[own->tests[t] * MODEL_MOTIONS + j] * model_units[j];
            for (int k = 0; k < own->count; k++)
                a[(n + j) * size + r] += own->shares[k] * model_taken[own->rows[k] * MODEL_MOTIONS + j] * model_units[j];
        }
    if (p->floats) memcpy(p->room->whole, a, sizeof(double) * size * size);
#endif
    return model_lu(a, size, p->room->pivots) ? n : -1;
}

#if MODEL_FLOATS
/* 0 for a solution that is round-off of a singular system, by its residual and its size. */
static inline int model_sound(const model_slider *p, int size) {
    const double *whole = p->room->whole, *right = p->room->right;
    double most = 0, largest = 0;
    for (int i = 0; i < size; i++) most = fmax(most, fabs(right[i])), largest = fmax(largest, fabs(p->x[i]));
    for (int i = 0; i < size; i++) {
        double left = right[i];
        for (int j = 0; j < size; j++) left -= whole[i * size + j] * p->x[j];
        if (!(fabs(left) <= MODEL_SINGULAR * most)) return 0;
    }
    return MODEL_SOFTNESS * largest <= MODEL_HUGE * most;
}
#endif

/* Forces, and motions, by the n unknowns of a factored system; 0 if they are undetermined. */
static inline int model_answered(model_slider *p, int n) {
    const int m = MODEL_CONDITIONS;
    double *pushed = p->y;
    int size = n;
    model_leave(p, p->known, pushed);
    for (int r = 0; r < n; r++) {
        p->x[r] = 0;
        for (int t = 0; t < p->columns[r].tested; t++) p->x[r] -= p->columns[r].weights[t] * pushed[p->columns[r].tests[t]];
    }
#if MODEL_FLOATS
    for (int j = 0; j < MODEL_MOTIONS && p->floats; j++) {
        double left = p->room->driving[j];
        for (int i = 0; i < m; i++) left -= p->known[i] * model_taken[i * MODEL_MOTIONS + j];
        p->x[size++] = model_units[j] * left;
    }
    if (p->floats) memcpy(p->room->right, p->x, size * sizeof(double));
#endif
    model_lu_solved(p->room->factored, size, p->room->pivots, p->x);
#if MODEL_FLOATS
    if (p->floats && !model_sound(p, size)) return 0;
    for (int j = 0; j < size - n; j++) p->motions[j] = model_units[j] * p->x[n + j];
#endif
    memcpy(p->forces, p->known, m * sizeof(double));
    for (int c = 0; c < n; c++)
        for (int k = 0; k < p->columns[c].count; k++) p->forces[p->columns[c].rows[k]] += p->columns[c].shares[k] * p->x[c];
    for (int i = 0; i < m; i++)
        if (!isfinite(p->forces[i])) return 0;
    return 1;
}

#if MODEL_FLOATS
/* 1 if forces balance the loads along all motions. */
static inline int model_rests(model_slider *p) {
    double left[MODEL_MOTIONS], sizes[MODEL_MOTIONS], most = 0;
    if (!p->floats) return 1;
    memcpy(p->room->forces, p->forces, MODEL_CONDITIONS * sizeof(double));
    model_balance(p->room, left, sizes, 0);
    for (int j = 0; j < MODEL_MOTIONS; j++) most = fmax(most, sizes[j]);
    for (int j = 0; j < MODEL_MOTIONS; j++)
        if (!(fabs(left[j]) <= MODEL_RESTING * most)) return 0;
    return 1;
}
#endif

/* 1 if some contact slips in a direction that may turn: Newton's method ends there near a solution, not on it. */
static inline int model_turns(const model_slider *p) {
    const unsigned char *slips = p->at + 2 * (size_t)MODEL_CONDITIONS;
    for (int contact = 0; contact < MODEL_CONTACTS; contact++)
        if (model_along[contact + 1] - model_along[contact] == 2 && slips[model_tangential[model_along[contact]]]) return 1;
    return 0;
}

/* Forces, and motions, that are kept, or put back. */
static inline void model_set_aside(model_slider *p, int back) {
    double *lists[] = {p->forces, p->kept};
    memcpy(lists[!back], lists[back], MODEL_CONDITIONS * sizeof(double));
#if MODEL_FLOATS
    lists[0] = p->motions, lists[1] = p->kept + MODEL_CONDITIONS;
    memcpy(lists[!back], lists[back], MODEL_MOTIONS * sizeof(double));
#endif
}

/* Residual of forces and motions, with their statuses; negative if they solve the increment to the tolerance. */
static inline double model_residual(model_slider *p, double probe, double noise) {
    model_leave_moved(p, p->forces, p->left);
    const double worst = model_projected(p, probe);
    int done = worst <= MODEL_TOLERANCE * model_most(p->forces) + MODEL_ROUND_OFF * noise;
#if MODEL_FLOATS
    done = done && model_rests(p);
#endif
    return done ? -worst - 1e-300 : worst;
}

/* A further step from forces that are near enough, if it comes nearer: where directions turn, and from those that were given,
   which solve nothing yet. Then the rows without slack and forces. */
static inline int model_nearest(model_slider *p, double probe, double noise, double off, int given) {
    const int m = MODEL_CONDITIONS;
    const unsigned char *acting = p->at, *slips = p->at + 2 * m;
    if (given || model_turns(p)) {
        model_set_aside(p, 0);
        const int n = model_on_statuses(p);
        const double left = n < 0 || !model_answered(p, n) ? 1 : model_residual(p, probe, noise);
        if (left >= 0 || left < off) model_set_aside(p, 1), model_residual(p, probe, noise);
    }
    for (int i = 0; i < m; i++) {
        if (!acting[i]) p->forces[i] = 0;
        if (acting[i] && !slips[i]) p->left[i] = 0;
    }
    return 1;
}

/* Newton's method from initial forces; stores forces and slacks if it converges, else returns 0. */
static inline int model_iterated(model_slider *p, const double *start, double probe) {
    const int m = MODEL_CONDITIONS;
    double noise = 0, least = INFINITY;
    memcpy(p->forces, start, m * sizeof(double));
    for (int i = 0; i < m; i++) noise = fmax(noise, fabs(p->stiffness[i] * p->slack[i]));
    for (int iteration = 0; iteration <= MODEL_RUBBED; iteration++) {
        const double found = model_residual(p, probe, noise), worst = fabs(found);
        if (found < 0) return model_nearest(p, probe, noise, found, !iteration);
        for (int k = 0; k < iteration; k++)
            if (!memcmp(p->seen + 3 * (size_t)m * k, p->at, 3 * (size_t)m) && !(worst < 0.5 * least)) return 0;
        memcpy(p->seen + 3 * (size_t)m * iteration, p->at, 3 * (size_t)m);
        least = fmin(least, worst);
        const int n = model_on_statuses(p);
        if (n < 0 || !model_answered(p, n)) return 0;
    }
    return 0;
}

static inline double model_drawn(const model_slider *p, const double *forces, int i) {
    double left = p->slack[i];
    for (int j = 0; j < MODEL_CONDITIONS; j++) left += p->schur[i * MODEL_CONDITIONS + j] * forces[j];
    return forces[i] - p->stiffness[i] * left;
}

/* Projections of single contacts, one after another, in place. */
static inline void model_swept(const model_slider *p, double *forces, int count) {
    for (int sweep = 0; sweep < count; sweep++) {
        for (int i = 0; i < MODEL_CONDITIONS; i++)
            if (p->pressing[i]) forces[i] = fmax(0, model_drawn(p, forces, i));
        for (int contact = 0; contact < MODEL_CONTACTS; contact++) {
            const int first = model_along[contact], count = model_along[contact + 1] - first;
            double moved[2] = {0, 0};
            for (int k = 0; k < count; k++) moved[k] = model_drawn(p, forces, model_tangential[first + k]);
            const double share = model_share(model_bounded(p, contact, forces[model_normal[contact]]), hypot(moved[0], moved[1]));
            for (int k = 0; k < count; k++) forces[model_tangential[first + k]] = share * moved[k];
        }
    }
}

/* Newton's method, with one factor of the slip after another. */
static inline int model_probed(model_slider *p) {
    static const double probes[] = {0.2, 1, 0.01};
#if MODEL_FLOATS
    double begin[MODEL_MOTIONS];
    memcpy(begin, p->motions, sizeof begin);
#endif
    for (size_t k = 0; k < sizeof probes / sizeof *probes; k++) {
#if MODEL_FLOATS
        memcpy(p->motions, begin, sizeof begin);
#endif
        if (model_iterated(p, p->start, probes[k])) return 1;
    }
    return 0;
}

/* Forces of bodies that are held, from those at the start, which sweeps improve in place. */
static inline int model_settles(model_slider *p) {
    static const int sweeps[] = {0, 10, 30, 100, 300, 1000, 3000};
    for (size_t s = 0; s < sizeof sweeps / sizeof *sweeps; s++) {
        model_swept(p, p->start, sweeps[s]);
        if (model_probed(p)) return 1;
    }
    return 0;
}

/* S with some slip of redundant rows: those that act on no unknown by a part of the compliance of their pressure; and the
   forces that turn the slack of a row into one. */
static inline void model_set_softened(model_slider *p, const double *schur) {
    const int m = MODEL_CONDITIONS;
    memcpy(p->schur, schur, m * m * sizeof(double));
    for (int k = 0; k < MODEL_TWICE; k++) {
        int own = 0;
        while (model_tangential[own] != model_twice[k]) own++;
        const int row = model_twice[k], pressure = model_normal[model_owner[own]];
        const double compliance = p->schur[row * m + row];
        p->schur[row * m + row] += MODEL_GIVES * (compliance > 0 ? compliance : p->schur[pressure * m + pressure]);
    }
}

static inline void model_set_stiffness(model_slider *p) {
    for (int i = 0; i < MODEL_CONDITIONS; i++) p->stiffness[i] = 1 / fabs(p->schur[i * MODEL_CONDITIONS + i]);
    for (int k = 0; k < MODEL_CONTACTS; k++) /* the same for both directions of a contact: the projection is on a disc */
        if (model_along[k + 1] - model_along[k] == 2) {
            const int one = model_tangential[model_along[k]], two = model_tangential[model_along[k] + 1];
            p->stiffness[one] = p->stiffness[two] = fmin(p->stiffness[one], p->stiffness[two]);
        }
}

/* Laws at a point; 0 if they are not numbers. */
static inline int model_set_laws(model_slider *p, const double *point) {
    for (int k = 0; k < MODEL_CONTACTS; k++) {
        const model_law *law = &model_laws[model_law_of[k]];
        p->coefficient[k] = law->coefficient ? MODEL_AT(law->coefficient, point) : INFINITY;
        p->limit[k] = law->limit ? MODEL_AT(law->limit, point) * model_area[k] : INFINITY;
        if (isnan(p->coefficient[k]) || isnan(p->limit[k])) return 0;
    }
    return 1;
}

#if MODEL_FLOATS
/* S and the slack of bodies on springs with given ends, from those of bodies without. */
static inline void model_hold(model_slider *p, const double *schur, double weak, const double *ends) {
    const int m = MODEL_CONDITIONS, r = MODEL_MOTIONS;
    double offset[MODEL_MOTIONS];
    for (int j = 0; j < r; j++) offset[j] = ends[j] + model_pushes[j] * weak * p->room->driving[j];
    for (int i = 0; i < m; i++) {
        p->slack[i] = p->bare[i] - model_taken_by(i, offset);
        for (int k = 0; k < m; k++) {
            p->schur[i * m + k] = schur[i * m + k];
            for (int j = 0; j < r; j++) p->schur[i * m + k] += model_taken[i * r + j] * model_pushes[j] * weak * model_taken[k * r + j];
        }
    }
    model_set_stiffness(p), p->floats = 0;
}

/* S and the slack of bodies without springs. */
static inline void model_let_go(model_slider *p, const double *schur) {
    memcpy(p->schur, schur, sizeof(double) * MODEL_CONDITIONS * MODEL_CONDITIONS);
    memcpy(p->slack, p->bare, MODEL_CONDITIONS * sizeof(double));
    model_set_stiffness(p), p->floats = 1;
}

/* Bodies that contact alone holds: with the motions as unknowns, or on weak springs whose ends follow the motions. */
static inline int model_settles_free(model_slider *p) {
    static const double weakness[] = {1e3, 1e5, 1e7, 1e9};
    const int m = MODEL_CONDITIONS, r = MODEL_MOTIONS;
    double ends[MODEL_MOTIONS], left[MODEL_MOTIONS], sizes[MODEL_MOTIONS], stiffest = 0, nothing;
    memset(p->motions, 0, sizeof ends), memset(ends, 0, sizeof ends);
    p->floats = 1;
    if (model_probed(p)) return 1;
    memcpy(p->bare, p->slack, m * sizeof(double)), memcpy(p->held, p->schur, m * m * sizeof(double));
    memset(p->start, 0, m * sizeof(double));
    for (int i = 0; i < m; i++) stiffest = fmax(stiffest, p->stiffness[i]);
    nothing = MODEL_NOTHING * model_most(p->bare) * stiffest;
    for (size_t s = 0; s < sizeof weakness / sizeof *weakness; s++)
        for (int step = 0; step < MODEL_SPRINGS; step++) {
            double most = 0;
            int close = 1;
            model_hold(p, p->held, weakness[s], ends);
            if (!model_settles(p)) return 0;
            memcpy(p->start, p->forces, m * sizeof(double)), memcpy(p->room->forces, p->forces, m * sizeof(double));
            model_balance(p->room, left, sizes, 0);
            for (int j = 0; j < r; j++) ends[j] += model_pushes[j] * weakness[s] * left[j], most = fmax(most, sizes[j]);
            for (int j = 0; j < r; j++) close = close && fabs(left[j]) <= MODEL_BALANCED * most + nothing;
            model_let_go(p, p->held);
            memcpy(p->motions, ends, sizeof ends);
            if (model_probed(p)) return 1;
            if (!close) continue;
            model_hold(p, p->held, weakness[s], ends); /* the statuses of bodies on springs */
            if (!model_settles(p)) return 0;
            memcpy(p->motions, ends, sizeof ends);
            return 1;
        }
    return 0;
}
#endif

/* Slip of undeformed bodies with gaps of all conditions: contacts that touch stick, as in plugins/friction/laws.py. */
#define MODEL_TOUCHING 1e-9
static inline int model_slip_at_rest(model_slider *p, const double *gaps, const double *point, model_slip *slip) {
    double length = 0;
    if (!model_set_laws(p, point)) return 0;
    for (int k = 0; k < MODEL_CONTACTS; k++) length += model_area[k];
    if (MODEL_TANGENTS > MODEL_CONTACTS) length = sqrt(length);
    for (int k = 0; k < MODEL_CONTACTS; k++) {
        slip->gap[k] = gaps[model_normal[k]], slip->bound[k] = model_bounded(p, k, 0);
        slip->statuses[k] = slip->gap[k] <= MODEL_TOUCHING * length;
    }
    return 1;
}

/* Slip after an increment: bounds and pressures along a slip are the means of both ends. */
static inline void model_remember(const model_slider *p, const model_slip *before, model_slip *after) {
    const int m = MODEL_CONDITIONS;
    const unsigned char *acting = p->at, *slips = p->at + 2 * m;
    double slipped[MODEL_CONTACTS];
    unsigned char slides[MODEL_CONTACTS];
    memset(slipped, 0, sizeof slipped), memset(slides, 0, sizeof slides);
    for (int k = 0; k < MODEL_TANGENTS; k++) {
        const int row = model_tangential[k], contact = model_owner[k];
        after->position[k] = before->position[k] + p->left[row];
        slipped[contact] = hypot(slipped[contact], p->left[row]);
        slides[contact] = slips[row] != 0;
    }
    for (int k = 0; k < MODEL_CONTACTS; k++) {
        const int row = model_normal[k];
        const double pressure = fmax(p->forces[row], 0), bound = model_bounded(p, k, p->forces[row]);
        const int closed_before = before->pressure[k] > 0 || before->bound[k] > 0 || before->statuses[k] != 0;
        const double closed = 0.5 * (closed_before + (pressure > 0 || bound > 0)), mean = 0.5 * (before->pressure[k] + pressure);
        after->gap[k] = p->left[row], after->pressure[k] = pressure, after->bound[k] = bound;
        after->slipped[k] = before->slipped[k] + slipped[k] * closed;
        after->work[k] = before->work[k] + 0.5 * (before->bound[k] + bound) * slipped[k];
        after->wear[k] = before->wear[k] + (model_area[k] > 0 ? mean / model_area[k] : 0) * slipped[k];
        after->statuses[k] = !acting[row] ? 0 : slides[k] ? 2 : 1;
    }
}

#if !MODEL_FLOWS && !MODEL_RANGED
#define MODEL_HALVED 6
#define MODEL_FEWEST 4
#define MODEL_CUTS 12
#define MODEL_SETTLED 1e-3
#define MODEL_WORK_LEAST 1e-3
#define MODEL_APART 1e-9
#define MODEL_POOL (3 * (MODEL_CUTS + 2))
#define MODEL_LAST (3 * (MODEL_CUTS + 1)) /* index of the end of an increment */

/* State of a path of elastic bodies. */
typedef struct {
    double *block, *point, *forces, *energy, *motions;
    model_slip slip;
    size_t size;
} model_state;

/* Room for a state; 0 without memory. */
static inline int model_state_new(model_state *s) {
    const model_row rows[] = {{&s->point, MODEL_PARAMETERS}, {&s->forces, MODEL_CONDITIONS}, {&s->energy, 1},
                              {&s->motions, MODEL_MOTIONS}, MODEL_SLIP_ROWS(s->slip)};
    s->block = model_block(MODEL_ROWS(rows), MODEL_SLIP_BYTES, &s->size);
    if (!s->block) return 0;
    s->slip.statuses = (unsigned char *)s->block + s->size - MODEL_SLIP_BYTES;
    return 1;
}

typedef struct {
    model_work *room;
    model_slider *slider;
    model_state *state, *pool;
    double largest, energy; /* denominators of errors */
    int begun;
} model_path;

static inline void model_path_free(model_path *p) {
    if (!p) return;
    for (int k = 0; p->pool && k < MODEL_POOL; k++) free(p->pool[k].block);
    if (p->state) free(p->state->block);
    model_slider_free(p->slider), model_free(p->room), free(p->state), free(p->pool), free(p);
}

/* A path that has not begun; NULL without memory. */
static inline model_path *model_path_new(void) {
    model_path *p = calloc(1, sizeof *p);
    if (!p) return NULL;
    p->room = model_new(), p->slider = model_slider_new(p->room), p->state = calloc(1, sizeof *p->state);
    p->pool = calloc(MODEL_POOL, sizeof *p->pool);
    int all = p->room && p->slider && p->state && p->pool && model_state_new(p->state);
    for (int k = 0; all && k < MODEL_POOL; k++) all = model_state_new(&p->pool[k]);
    if (all) return p;
    model_path_free(p);
    return NULL;
}

/* Elastic energy of contact forces, with S without regularisation. */
static inline double model_energy(const model_path *p) {
    const model_slider *q = p->slider;
    double energy = 0;
    for (int i = 0; i < MODEL_CONDITIONS; i++)
        for (int j = 0; j < MODEL_CONDITIONS; j++)
            energy += 0.5 * q->forces[i] * p->room->schur[i * MODEL_CONDITIONS + j] * q->forces[j];
    return energy;
}

/* State after an increment to a point; 0 if it does not converge. */
static inline int model_increment(model_path *p, const model_state *before, const double *point, model_state *after) {
    model_slider *q = p->slider;
    if (!model_set_contact(p->room, point)) return 0;
    p->room->started = 1; /* S is computed */
    memcpy(q->slack, p->room->slack, MODEL_CONDITIONS * sizeof(double));
    memcpy(q->start, before->forces, MODEL_CONDITIONS * sizeof(double));
    for (int k = 0; k < MODEL_TANGENTS; k++) q->slack[model_tangential[k]] -= before->slip.position[k];
    model_set_softened(q, p->room->schur), model_set_stiffness(q);
    if (!model_set_laws(q, point)) return 0;
#if MODEL_FLOATS
    if (!model_settles_free(q)) return 0;
    memcpy(after->motions, q->motions, MODEL_MOTIONS * sizeof(double));
#else
    if (!model_settles(q)) return 0;
#endif
    memcpy(after->point, point, MODEL_PARAMETERS * sizeof(double));
    memcpy(after->forces, q->forces, MODEL_CONDITIONS * sizeof(double));
    *after->energy = model_energy(p);
    model_remember(q, &before->slip, &after->slip);
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
    for (int k = 0; k < MODEL_CONTACTS; k++) apart = fmax(apart, MODEL_APART * fabs(before->slip.gap[k]));
    for (int k = 0; k < MODEL_TANGENTS; k++) {
        const int contact = model_owner[k];
        const double force = after->forces[model_tangential[k]];
        if (after->slip.pressure[contact] > 0 && before->slip.gap[contact] > apart) square += force * force;
    }
    return square;
}

/* Error estimate by halving an increment: forces over the largest, dissipated work over the total of the path. */
static inline double model_off(const model_path *p, const model_state *before, const model_state *half,
                               const model_state *second, const model_state *whole) {
    double change = 0, work = 0, other = 0;
    for (int i = 0; i < MODEL_CONDITIONS; i++)
        change += (second->forces[i] - whole->forces[i]) * (second->forces[i] - whole->forces[i]);
    for (int k = 0; k < MODEL_CONTACTS; k++) work += second->slip.work[k], other += whole->slip.work[k];
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
    p->energy = fmax(p->energy, *after->energy);
    return 1;
}

/* An increment of proportional loading, halved until that changes little, as in models/histories/sliding.py. */
static inline int model_careful(model_path *p, const model_state *before, const double *point, model_state *after, int depth) {
    double middle[MODEL_PARAMETERS];
    model_state *half = &p->pool[3 * depth], *whole = half + 1, *second = half + 2;
    const int single = model_tried(p, before, point, whole);
    if (depth >= (single ? MODEL_CUTS : MODEL_HALVED)) {
        if (single) model_copy(after, whole), MODEL_REACHED(whole);
        return single;
    }
    model_between(before->point, point, 0.5, middle);
    if (model_tried(p, before, middle, half) && single && model_tried(p, half, point, second) &&
        (model_off(p, before, half, second, whole) <= MODEL_SETTLED || depth + 1 >= MODEL_CUTS)) {
        MODEL_REACHED(half), MODEL_REACHED(second);
        model_copy(after, second);
        return 1;
    }
    return model_careful(p, before, middle, half, depth + 1) && model_careful(p, half, point, after, depth + 1);
}

static inline int model_told(model_path *p, double *forces, double *outputs) {
    model_work *w = p->room;
    if (!model_set_contact(w, p->state->point)) return MODEL_NO_ANSWER;
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
    double from[MODEL_PARAMETERS];
    model_start(point, from);
    memset(p->state->block, 0, p->state->size);
    memcpy(p->state->point, from, sizeof from);
    p->begun = 0, p->largest = p->energy = 0;
    if (!model_stays(point)) return MODEL_OUTSIDE;
    if (!model_set_contact(p->room, from)) return MODEL_NO_ANSWER;
    p->room->started = 1;
    if (!model_slip_at_rest(p->slider, p->room->slack, from, &p->state->slip)) return MODEL_NO_ANSWER;
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
        model_copy(p->state, reached);
    }
    return model_told(p, forces, outputs);
}
#endif
