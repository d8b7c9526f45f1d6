
/* Histories of inelastic bodies: plastic corrections and all contact forces of an increment, by Newton's method with a line
   search, as in plugins/inelastic/condensed_step.py. Strains and memory are stored component by component. Where contacts rub, each correction has an
   increment of friction, see friction.h. */
#define MODEL_SIZE (MODEL_COMPONENTS * MODEL_POINTS)
#define MODEL_NEWTON 60
#define MODEL_CORRECTED 1e-11
#define MODEL_NEAREST 1e-13 /* where further steps end, if round-off lets them get there */
#define MODEL_QUICK 0.1
#define MODEL_LEAST (1.0 / 256)
#define MODEL_DECREASE 1e-4
#define MODEL_HALVED 6
#define MODEL_LAST (MODEL_HALVED + 1) /* index of the end of an increment */
#define MODEL_STEPS 40
#define MODEL_ALONE 0.01 /* strains are not small: above 1 in more than this part of the points, */
#define MODEL_RUNAWAY 100

#if !MODEL_RUBS
#define MODEL_SLIP_BYTES 0
#endif

/* State of a history. */
typedef struct {
    double *block, *point, *correction, *forces;
    double *memory;  /* inelastic strain, its cumulated amount, and further variables of laws */
    double *largest; /* denominator of errors of corrections */
    double *motions; /* of bodies that contact alone holds */
    unsigned char *active, *elastic, *loaded; /* the last: 1 if statuses are known */
#if MODEL_RUBS
    model_slip slip;
#endif
    size_t size;
} model_state;

/* Room for a state; 0 without memory. */
static inline int model_state_new(model_state *s) {
    const size_t m = MODEL_CONDITIONS;
    const model_row rows[] = {{&s->point, MODEL_PARAMETERS}, {&s->correction, MODEL_MODES}, {&s->forces, m},
                              {&s->memory, (size_t)MODEL_MEMORY * MODEL_POINTS}, {&s->largest, 1}, {&s->motions, MODEL_MOTIONS},
#if MODEL_RUBS
                              MODEL_SLIP_ROWS(s->slip)
#endif
    };
    s->block = model_block(MODEL_ROWS(rows), 2 * m + 1 + MODEL_SLIP_BYTES, &s->size);
    if (!s->block) return 0;
    s->active = (unsigned char *)s->block + s->size - (2 * m + 1 + MODEL_SLIP_BYTES);
    s->elastic = s->active + m, s->loaded = s->elastic + m;
#if MODEL_RUBS
    s->slip.statuses = s->loaded + 1;
#endif
    return 1;
}

/* Results of an increment at a correction. */
typedef struct {
    double *block, *correction, *residual, *forces, *motions, *strain, *memory, merit;
    unsigned char *active;
} model_trial;

static inline model_trial *model_trial_new(void) {
    model_trial *t = calloc(1, sizeof *t);
    if (!t) return NULL;
    const model_row rows[] = {{&t->correction, MODEL_MODES}, {&t->residual, MODEL_MODES}, {&t->forces, MODEL_CONDITIONS},
                              {&t->motions, MODEL_MOTIONS}, {&t->strain, MODEL_SIZE}, {&t->memory, (size_t)MODEL_MEMORY * MODEL_POINTS}};
    size_t size;
    t->block = model_block(MODEL_ROWS(rows), MODEL_CONDITIONS, &size);
    t->active = (unsigned char *)t->block + size - MODEL_CONDITIONS;
    return t;
}

typedef struct {
    model_work *room;
    model_state *state, *pool;
#if MODEL_RUBS
    model_slider *slider;
#endif
    model_trial *here, *next;
    model_place *place;
    double *block, *tested, *scale, *coupled, *constants, *slopes, *slack, *strain, *elastic, *sizes; /* of an increment */
    double *jacobian, *inner, *columns, *under, *flowing, *gives, weight, dt;
    double *compliances; /* C^-1 of each body */
    double seconds; /* of an increment, or of the first load */
    int *order, *on, *places, tangent, known, begun, parts; /* the last: increments within the seconds */
} model_path;

static inline void model_path_free(model_path *p) {
    if (!p) return;
#if MODEL_RUBS
    model_slider_free(p->slider);
#endif
    for (int k = 0; p->pool && k < MODEL_HALVED + 2; k++) free(p->pool[k].block);
    if (p->state) free(p->state->block);
    if (p->here) free(p->here->block);
    if (p->next) free(p->next->block);
    model_free(p->room), free(p->state), free(p->pool), free(p->here), free(p->next), model_place_free(p->place);
    free(p->block), free(p->order), free(p->on), free(p->places), free(p);
}

static inline double model_norm(const double *values, int count) {
    double squares = 0;
    for (int k = 0; k < count; k++) squares += values[k] * values[k];
    return sqrt(squares);
}

/* Factor of C at a point of a body. */
static inline double model_grading(const model_body *body, int point) { return body->grading ? body->grading[point] : 1; }

/* Weights times the stress of each mode. */
static inline void model_set_tested(model_path *p) {
    const int n = MODEL_POINTS, c = MODEL_COMPONENTS;
    for (int g = 0, k = 0, first = 0; g < MODEL_BODIES; first += model_bodies[g++].points)
        for (; k < first + model_bodies[g].points; k++)
            for (int row = 0; row < MODEL_MODES * c; row++) {
                const double *own = model_per_mode + (size_t)(row / c) * MODEL_SIZE + k, *elastic = model_bodies[g].elastic + row % c * c;
                double stress = 0;
                for (int l = 0; l < c; l++) stress += elastic[l] * own[l * n];
                p->tested[(size_t)row * n + k] = model_weights[k] * model_grading(&model_bodies[g], k - first) * stress;
            }
    p->weight = model_norm(p->tested, MODEL_MODES * MODEL_SIZE);
}

/* A history that has not begun; NULL without memory. */
static inline model_path *model_path_new(void) {
    const size_t m = MODEL_CONDITIONS, ell = MODEL_MODES, size = MODEL_SIZE, n = MODEL_POINTS, c = MODEL_COMPONENTS;
    model_path *p = calloc(1, sizeof *p);
    if (!p) return NULL;
    p->room = model_new(), p->state = calloc(1, sizeof *p->state), p->pool = calloc(MODEL_HALVED + 2, sizeof *p->pool);
    p->here = model_trial_new(), p->next = model_trial_new(), p->place = model_place_new(), p->seconds = p->parts = 1;
    const model_row rows[] = {{&p->tested, ell * size}, {&p->scale, n}, {&p->coupled, ell * m}, {&p->constants, n * MODEL_CONSTANTS},
                              {&p->slopes, size * c}, {&p->slack, m}, {&p->strain, size}, {&p->elastic, m}, {&p->sizes, n},
                              {&p->jacobian, ell * ell}, {&p->inner, m * m}, {&p->columns, ell * m}, {&p->under, ell * size},
                              {&p->flowing, size}, {&p->gives, MODEL_SHARES}, {&p->compliances, MODEL_BODIES * c * c}};
    size_t bytes;
    p->block = model_block(MODEL_ROWS(rows), 0, &bytes);
    p->order = malloc(ell * sizeof(int)), p->on = malloc(m * sizeof(int)), p->places = malloc(size * sizeof(int));
    int all = p->room && p->state && p->pool && p->here && p->here->block && p->next && p->next->block && p->place && p->block;
    all = all && p->order && p->on && p->places && model_state_new(p->state);
    for (int k = 0; all && k < MODEL_HALVED + 2; k++) all = model_state_new(&p->pool[k]);
#if MODEL_RUBS
    all = (p->slider = model_slider_new(p->room)) && all;
#endif
    if (all) {
        model_set_tested(p);
        return p;
    }
    model_path_free(p);
    return NULL;
}

/* Elasticity at a point; moduli do not change within a history. */
static inline int model_set_elasticity(model_path *p, const double *point) {
    const int m = MODEL_CONDITIONS;
    double *schur = p->room->schur;
    int same = p->known;
    for (int q = 0; q < MODEL_SHARES; q++) {
        const double gives = MODEL_MODULI ? model_middle[q] / MODEL_AT(model_moduli[q].value, point) : 1;
        if (!isfinite(gives)) return 0;
        same = same && p->gives[q] == gives;
        p->gives[q] = gives;
    }
    if (same) return 1;
    p->known = 1, p->tangent = 0;
    memset(schur, 0, m * m * sizeof(double));
    const double *half = model_flow_schur;
    for (int q = 0; q < MODEL_SHARES; q++)
        for (int i = 0; i < m; i++)
            for (int j = 0; j <= i; j++, half++) {
                schur[i * m + j] += p->gives[q] * *half;
                if (i != j) schur[j * m + i] += p->gives[q] * *half;
            }
    for (int k = 0; k < MODEL_POINTS; k++) p->scale[k] = p->gives[model_share_of[k]];
    for (int g = 0, k = 0; g < MODEL_BODIES; k += model_bodies[g++].points) /* all its points are on parts of one modulus */
        for (int i = 0; i < MODEL_COMPONENTS * MODEL_COMPONENTS; i++) p->compliances[g * MODEL_COMPONENTS * MODEL_COMPONENTS + i] = p->scale[k] * model_bodies[g].compliance[i];
    for (int j = 0; j < MODEL_MODES; j++)
        for (int i = 0; i < m; i++) p->coupled[j * m + i] = model_coupled[j * m + i] * p->gives[model_mode_share[j]];
    return 1;
}

/* E, the ratio of Poisson and the constants of the law of each point; 0 if they are invalid. */
static inline int model_set_constants(model_path *p, const double *point) {
    double at[MODEL_PARAMETERS + 4], *found = p->constants; /* with three coordinates and the grading */
    memcpy(at, point, MODEL_PARAMETERS * sizeof(double));
    for (int g = 0; g < MODEL_BODIES; g++) {
        const model_body *body = &model_bodies[g];
        for (int k = 0; k < body->points; k++, found += MODEL_CONSTANTS) {
            if (k && !body->places) {
                memcpy(found, found - MODEL_CONSTANTS, MODEL_CONSTANTS * sizeof(double));
                continue;
            }
            for (int i = 0; i < body->coordinates; i++) at[MODEL_PARAMETERS + i] = body->places[k * body->coordinates + i];
            for (int i = 0; i < body->constants_count; i++) found[i] = MODEL_AT(body->constants[i], at);
            if (!(found[0] > 0)) return 0;
            for (int i = 2; i < body->constants_count; i++)
                if (!(found[i] > body->law->low[i - 2] && found[i] < body->law->high[i - 2])) return 0;
        }
    }
    return 1;
}

/* Slack and strain of loads, without correction and forces. */
static inline void model_set_loads(model_path *p) {
    const int m = MODEL_CONDITIONS, terms = MODEL_TERMS;
    const double *theta = p->room->theta;
    for (int i = 0; i < m; i++) {
        p->slack[i] = 0;
        for (int t = 0; t < terms; t++) {
            double share = model_gaps[i * terms + t];
            for (int q = 0; q < MODEL_SHARES; q++) share -= p->gives[q] * model_pressed[((size_t)q * m + i) * terms + t];
            p->slack[i] += share * theta[t];
        }
    }
#if MODEL_FLOATS
    for (int j = 0; j < MODEL_MOTIONS; j++) {
        p->room->driving[j] = 0;
        for (int t = 0; t < terms; t++) p->room->driving[j] += model_driving[j * terms + t] * theta[t];
    }
#endif
    for (int k = 0; k < MODEL_SIZE; k++) {
        p->strain[k] = 0;
        for (int t = 0; t < terms; t++) {
            const size_t place = (size_t)k * terms + t;
            p->strain[k] += (p->scale[k % MODEL_POINTS] * model_forced[place] + model_given[place]) * theta[t];
        }
    }
}

#if MODEL_RUBS
/* Slip of undeformed bodies at a point; 0 if laws are not numbers. */
static inline int model_rest_slip(model_path *p, const double *point) {
    model_set_theta(p->room, point);
    for (int i = 0; i < MODEL_CONDITIONS; i++) {
        p->slack[i] = 0;
        for (int t = 0; t < MODEL_TERMS; t++) p->slack[i] += model_gaps[i * MODEL_TERMS + t] * p->room->theta[t];
    }
    return model_slip_at_rest(p->slider, p->slack, point, &p->state->slip);
}

/* Laws of friction at a point, S, and slacks less what has slipped; 0 if laws are not numbers. */
static inline int model_ready(model_path *p, const model_state *before, const double *point) {
    for (int k = 0; k < MODEL_TANGENTS; k++) p->slack[model_tangential[k]] -= before->slip.position[k];
    model_set_softened(p->slider, p->room->schur), model_set_stiffness(p->slider);
    memset(p->elastic, 0, MODEL_CONDITIONS * sizeof(double));
    return model_set_laws(p->slider, point);
}

/* The increment of friction under a slack, from the forces of a trial or a state. */
static inline int model_touched(model_path *p, const double *slack, const double *forces) {
    for (int i = 0; i < MODEL_CONDITIONS; i++)
        if (!isfinite(slack[i])) return 0;
    memcpy(p->slider->slack, slack, MODEL_CONDITIONS * sizeof(double));
    memcpy(p->slider->start, forces, MODEL_CONDITIONS * sizeof(double));
#if MODEL_FLOATS
    model_set_softened(p->slider, p->room->schur), model_set_stiffness(p->slider); /* springs may have held it last */
    return model_settles_free(p->slider);
#else
    return model_settles(p->slider);
#endif
}
#else
/* The contact problem of a slack, from initial statuses or, without any, from those of the slack. */
static inline int model_touched(model_path *p, const double *slack, const unsigned char *start) {
    model_work *w = p->room;
    for (int i = 0; i < MODEL_CONDITIONS; i++) {
        if (!isfinite(slack[i])) return 0;
        w->slack[i] = slack[i], w->active[i] = start ? start[i] : slack[i] < 0;
    }
#if MODEL_FLOATS
    return model_held(w);
#else
    return model_settled(w);
#endif
}

/* Forces of the elastic bodies, by which the cubature is corrected, and their statuses; 0 without any. */
static inline int model_ready(model_path *p, const model_state *before, unsigned char *elastic) {
    if (!model_touched(p, p->slack, *before->loaded ? before->elastic : NULL)) return 0;
    memcpy(p->elastic, p->room->forces, MODEL_CONDITIONS * sizeof(double));
    memcpy(elastic, p->room->active, MODEL_CONDITIONS);
    return 1;
}
#endif

/* The contact problem under the correction of a trial, from forces or statuses; 0 without a solution. */
static inline int model_pressed_by(model_path *p, const double *forces, const unsigned char *start, model_trial *out) {
    double slack[MODEL_CONDITIONS];
    memcpy(slack, p->slack, sizeof slack);
    for (int i = 0; i < MODEL_CONDITIONS; i++)
        for (int j = 0; j < MODEL_MODES; j++) slack[i] -= model_moved[i * MODEL_MODES + j] * out->correction[j];
#if MODEL_RUBS
    (void)start;
    if (!model_touched(p, slack, forces)) return 0;
    memcpy(out->forces, p->slider->forces, MODEL_CONDITIONS * sizeof(double));
    memcpy(out->active, p->slider->at, MODEL_CONDITIONS);
#if MODEL_FLOATS
    memcpy(out->motions, p->slider->motions, MODEL_MOTIONS * sizeof(double));
#endif
#else
    (void)forces;
    if (!model_touched(p, slack, start)) return 0;
    memcpy(out->forces, p->room->forces, MODEL_CONDITIONS * sizeof(double));
    memcpy(out->active, p->room->active, MODEL_CONDITIONS);
#if MODEL_FLOATS
    memcpy(out->motions, p->room->motions, MODEL_MOTIONS * sizeof(double));
#endif
#endif
    return 1;
}

/* Memory of all points at the end of an increment or, with a number of those that flow, their slopes; 0 without an answer. */
static inline int model_set_memory(model_path *p, const model_state *before, model_trial *out, int *count) {
    const int n = MODEL_POINTS, c = MODEL_COMPONENTS;
    double strain[MODEL_COMPONENTS], old[MODEL_MEMORY], compliance[MODEL_COMPONENTS * MODEL_COMPONENTS];
    int k = 0, first = 0;
    if (!count) memcpy(out->memory, before->memory, sizeof(double) * MODEL_MEMORY * MODEL_POINTS);
    for (int g = 0; g < MODEL_BODIES; first += model_bodies[g++].points)
        for (; k < first + model_bodies[g].points; k++) {
            const model_program *law = model_bodies[g].law;
            const double *constants = p->constants + (size_t)k * MODEL_CONSTANTS, graded = model_grading(&model_bodies[g], k - first);
            if (!law) continue;
            for (int i = 0; i < c * c; i++) compliance[i] = p->compliances[g * c * c + i] / graded;
            for (int i = 0; i < c; i++) strain[i] = out->strain[i * n + k];
            for (int i = 0; i < law->memory; i++) old[i] = before->memory[i * n + k];
            if (!model_solve_law(law, p->place, strain, old, p->dt, constants, compliance)) return 0;
            if (!count)
                for (int i = 0; i < law->memory; i++) out->memory[i * n + k] = p->place->memory[i];
            else if (model_set_slopes(law, p->place, compliance, p->slopes + (size_t)*count * c))
                for (int i = 0; i < c; i++) p->places[(*count)++] = i * n + k;
        }
    return 1;
}

/* Contact forces, strain, memory and residual at the correction of a trial; 0 without a solution. */
static inline int model_tried(model_path *p, const model_state *before, const double *forces, const unsigned char *start,
                              model_trial *out) {
    const int m = MODEL_CONDITIONS, ell = MODEL_MODES, n = MODEL_POINTS;
    if (!model_pressed_by(p, forces, start, out)) return 0;
    memset(out->strain, 0, MODEL_SIZE * sizeof(double));
    for (int i = 0; i < m; i++)
        if (out->forces[i] != 0)
            for (int k = 0; k < MODEL_SIZE; k++) out->strain[k] += out->forces[i] * model_per_force[(size_t)i * MODEL_SIZE + k];
    for (int k = 0; k < MODEL_SIZE; k++) out->strain[k] = p->strain[k] - p->scale[k % n] * out->strain[k];
    for (int j = 0; j < ell; j++)
        for (int k = 0; k < MODEL_SIZE; k++) out->strain[k] += out->correction[j] * model_per_mode[(size_t)j * MODEL_SIZE + k];
    if (!model_set_memory(p, before, out, NULL)) return 0;
    for (int j = 0; j < ell; j++) {
        double left = 0;
        for (int k = 0; k < MODEL_SIZE; k++) left += p->tested[(size_t)j * MODEL_SIZE + k] * out->memory[k];
        for (int i = 0; i < ell; i++) left -= model_modal[j * ell + i] * out->correction[i];
        for (int i = 0; i < m; i++) left -= p->coupled[j * m + i] * (out->forces[i] - p->elastic[i]);
        out->residual[j] = left;
    }
    out->merit = model_norm(out->residual, ell);
    return isfinite(out->merit);
}

/* Subtracts the plastic part from Newton's matrix, if there is any, with the response of n forces to each mode. */
static inline void model_take_flow(model_path *p, const model_state *before, model_trial *here, int n) {
    const int ell = MODEL_MODES, m = MODEL_CONDITIONS, c = MODEL_COMPONENTS;
    int count = 0;
    if (!memcmp(here->memory, before->memory, MODEL_SIZE * sizeof(double)) || !model_set_memory(p, before, here, &count)) return;
    for (int j = 0; j < ell; j++) {
        double *strain = p->under + (size_t)j * count;
        for (int q = 0; q < count; q++) strain[q] = model_per_mode[(size_t)j * MODEL_SIZE + p->places[q]];
        for (int a = 0; a < n; a++) {
            const double *row = model_per_force + (size_t)p->on[a] * MODEL_SIZE, share = p->columns[j * m + a];
            for (int q = 0; q < count; q++) strain[q] -= share * p->scale[p->places[q] % MODEL_POINTS] * row[p->places[q]];
        }
    }
    for (int j = 0; j < ell; j++) {
        const double *tested = p->tested + (size_t)j * MODEL_SIZE;
        for (int q = 0; q < count; q++) {
            const int first = q - q % c;
            p->flowing[q] = 0;
            for (int i = 0; i < c; i++) p->flowing[q] += tested[p->places[first + i]] * p->slopes[(first + i) * c + q % c];
        }
        for (int l = 0; l < ell; l++) {
            double total = 0;
            for (int q = 0; q < count; q++) total += p->flowing[q] * p->under[(size_t)l * count + q];
            p->jacobian[j * ell + l] -= total;
        }
    }
}

/* Derivatives of the forces of some conditions, on, by the corrections of a trial, on its statuses: W = S_AA^-1 (B V)_A, or
   those of an increment of friction. Returns how many conditions there are, -1 if forces are undetermined. */
static inline int model_set_pushes(model_path *p, model_trial *here) {
    const int m = MODEL_CONDITIONS, ell = MODEL_MODES;
    int n = 0;
#if MODEL_RUBS
    model_slider *q = p->slider;
    if (!model_pressed_by(p, here->forces, NULL, here)) return -1; /* other trials were solved since: its statuses again */
    const int size = model_on_statuses(q);
    if (size < 0) return -1;
    for (int i = 0; i < m; i++)
        if (here->active[i]) p->on[n++] = i;
    memset(q->known, 0, m * sizeof(double));
#if MODEL_FLOATS
    double driving[MODEL_MOTIONS]; /* a correction changes no load */
    memcpy(driving, p->room->driving, sizeof driving), memset(p->room->driving, 0, sizeof driving);
#endif
    int answered = 1;
    for (int j = 0; answered && j < ell; j++) {
        for (int i = 0; i < m; i++) q->slack[i] = -model_moved[i * ell + j];
        answered = model_answered(q, size);
        for (int a = 0; a < n; a++) p->columns[j * m + a] = q->forces[p->on[a]];
    }
#if MODEL_FLOATS
    memcpy(p->room->driving, driving, sizeof driving);
#endif
    if (!answered) return -1;
#else
    for (int i = 0; i < m; i++)
        if (here->active[i]) p->on[n++] = i;
    for (int a = 0; a < n; a++)
        for (int b = 0; b < n; b++) {
            p->inner[a * n + b] = p->room->schur[p->on[a] * m + p->on[b]];
#if MODEL_FLOATS /* loose bodies on weak springs: a tangent needs few digits, and motions may be undetermined */
            for (int k = 0; k < MODEL_MOTIONS; k++)
                p->inner[a * n + b] += model_taken[p->on[a] * MODEL_MOTIONS + k] * model_pushes[k] * MODEL_WEAK *
                                       model_taken[p->on[b] * MODEL_MOTIONS + k];
#endif
        }
    if (!model_lu(p->inner, n, p->room->pivots)) return -1;
    for (int j = 0; j < ell; j++) {
        double *column = p->columns + j * m;
        for (int a = 0; a < n; a++) column[a] = model_moved[p->on[a] * ell + j];
        model_lu_solved(p->inner, n, p->room->pivots, column);
    }
#endif
    return n;
}

/* Newton's matrix at a trial, factored: -J = Q + P_A W less the plastic part of E_p - E_X,A^T W. */
static inline int model_linearised(model_path *p, const model_state *before, model_trial *here) {
    const int m = MODEL_CONDITIONS, ell = MODEL_MODES, n = model_set_pushes(p, here);
    if (n < 0) return 0;
    memcpy(p->jacobian, model_modal, ell * ell * sizeof(double));
    for (int j = 0; j < ell; j++)
        for (int a = 0; a < n; a++)
            for (int row = 0; row < ell; row++)
                p->jacobian[row * ell + j] += p->coupled[row * m + p->on[a]] * p->columns[j * m + a];
    model_take_flow(p, before, here, n);
    if (!model_lu(p->jacobian, ell, p->order)) return 0;
    for (int k = 0; k < ell * ell; k++)
        if (!isfinite(p->jacobian[k])) return 0;
    return 1;
}

/* A fraction of Newton's step from one trial to the next; 0 if it does not reach a merit. */
static inline int model_stepped(model_path *p, const model_state *before, double share, double most) {
    double step[MODEL_MODES];
    memcpy(step, p->here->residual, sizeof step);
    model_lu_solved(p->jacobian, MODEL_MODES, p->order, step);
    for (int j = 0; j < MODEL_MODES; j++) p->next->correction[j] = p->here->correction[j] + share * step[j];
    if (!model_tried(p, before, p->here->forces, p->here->active, p->next) || !(p->next->merit <= most)) return 0;
    model_trial *past = p->here;
    p->here = p->next, p->next = past;
    return 1;
}

/* A step with the cached matrix if it helps enough, else with the current one, shortened until the residual decreases. */
static inline int model_nearer(model_path *p, const model_state *before) {
    const double merit = p->here->merit;
    if (p->tangent && model_stepped(p, before, 1, MODEL_QUICK * merit)) return 1;
    p->tangent = model_linearised(p, before, p->here);
    for (double share = 1; p->tangent && share >= MODEL_LEAST; share /= 2)
        if (model_stepped(p, before, share, (1 - MODEL_DECREASE * share) * merit)) return 1;
    p->tangent = 0;
    return 0;
}

/* Steps beyond convergence, while they help: to the accuracy of Python's answers with small tolerances. */
static inline void model_refine(model_path *p, const model_state *before, double most) {
    while (!(p->here->merit <= MODEL_NEAREST * most)) {
        if (p->tangent && model_stepped(p, before, 1, MODEL_QUICK * p->here->merit)) continue;
        p->tangent = model_linearised(p, before, p->here);
        if (p->tangent) model_stepped(p, before, 1, p->here->merit);
        return;
    }
}

/* 1 if strains are small enough for the theory of small strains. */
static inline int model_small(model_path *p) {
    const int n = MODEL_POINTS, alone = (int)fmax(floor(MODEL_ALONE * n), 1);
    double most = 0;
    int large = 0;
    for (int k = 0; k < n; k++) p->sizes[k] = 0;
    for (int k = 0; k < MODEL_SIZE; k++) p->sizes[k % n] = fmax(p->sizes[k % n], fabs(p->here->strain[k]));
    for (int k = 0; k < n; k++) most = fmax(most, p->sizes[k]), large += p->sizes[k] > 1;
    return large < alone && most <= MODEL_RUNAWAY;
}

/* State after an increment to a point; 0 if it does not converge. */
static inline int model_increment(model_path *p, const model_state *before, const double *point, model_state *after) {
    if (!model_possible(point)) return 0;
    model_set_theta(p->room, point);
    if (!model_set_elasticity(p, point) || !model_set_constants(p, point)) return 0;
    model_set_loads(p);
#if MODEL_RUBS
    if (!model_ready(p, before, point)) return 0;
#else
    unsigned char elastic[MODEL_CONDITIONS];
    if (!model_ready(p, before, elastic)) return 0;
#endif
    memcpy(p->here->correction, before->correction, MODEL_MODES * sizeof(double));
    if (!model_tried(p, before, before->forces, before->active, p->here)) return 0;
    double largest = fmax(*before->largest, MODEL_NOISE * p->weight * model_norm(p->here->strain, MODEL_SIZE) / MODEL_CORRECTED);
    int iteration = 0;
    while (!(p->here->merit <= MODEL_CORRECTED * fmax(model_norm(p->here->correction, MODEL_MODES), largest)))
        if (++iteration == MODEL_NEWTON || !model_nearer(p, before)) return 0;
    model_refine(p, before, fmax(model_norm(p->here->correction, MODEL_MODES), largest));
    if (!model_small(p)) return 0;
    largest = fmax(largest, model_norm(p->here->correction, MODEL_MODES));
    memcpy(after->point, point, MODEL_PARAMETERS * sizeof(double));
    memcpy(after->correction, p->here->correction, MODEL_MODES * sizeof(double));
    memcpy(after->forces, p->here->forces, MODEL_CONDITIONS * sizeof(double));
    memcpy(after->memory, p->here->memory, sizeof(double) * MODEL_MEMORY * MODEL_POINTS);
    memcpy(after->active, p->here->active, MODEL_CONDITIONS);
    memcpy(after->motions, p->here->motions, MODEL_MOTIONS * sizeof(double));
#if MODEL_RUBS
    if (!model_pressed_by(p, p->here->forces, NULL, p->here)) return 0; /* other trials were solved since: its slip again */
    model_remember(p->slider, &before->slip, &after->slip);
#else
    memcpy(after->elastic, elastic, sizeof elastic);
#endif
    *after->largest = largest, *after->loaded = 1;
    return 1;
}

/* An increment, in halves if necessary. */
static inline int model_reached(model_path *p, const model_state *before, const double *point, model_state *after, int depth) {
    double middle[MODEL_PARAMETERS];
    model_state *half = &p->pool[depth];
    p->dt = ldexp(p->seconds / p->parts, -depth);
    if (model_increment(p, before, point, after)) return 1;
    if (depth == MODEL_HALVED) return 0;
    model_between(before->point, point, 0.5, middle);
    return model_reached(p, before, middle, half, depth + 1) && model_reached(p, half, point, after, depth + 1);
}

static inline int model_told(model_path *p, double *forces, double *outputs) {
    model_work *w = p->room;
    model_set_theta(w, p->state->point);
    memcpy(w->forces, p->state->forces, MODEL_CONDITIONS * sizeof(double));
    w->correction = p->state->correction, w->gives = p->gives;
#if MODEL_FLOATS
    memcpy(w->motions, p->state->motions, MODEL_MOTIONS * sizeof(double));
#endif
    if (forces) memcpy(forces, w->forces, MODEL_CONDITIONS * sizeof(double));
    if (outputs) model_read(w, outputs);
    return MODEL_DONE;
}

/* Begin at rest, at the point of the box nearest to zero, with the moduli and law constants of a point. */
static inline int model_rest(model_path *p, const double *point) {
    memset(p->state->block, 0, p->state->size);
    model_start(point, p->state->point);
    p->begun = p->tangent = 0;
    if (!model_stays(point)) return MODEL_OUTSIDE;
#if MODEL_RUBS
    if (!model_rest_slip(p, p->state->point)) return MODEL_NO_ANSWER;
#endif
    p->begun = 1;
    return MODEL_DONE;
}

/* Begin at rest, with proportional loading up to a point, in increments of a fortieth of the box, within the
   seconds of the path. Forces, (MODEL_CONDITIONS),
   and outputs, (MODEL_OUTPUTS), may be NULL. */
static inline int model_begin(model_path *p, const double *point, double *forces, double *outputs) {
    double from[MODEL_PARAMETERS], next[MODEL_PARAMETERS], far = 0;
    model_state *reached = &p->pool[MODEL_LAST];
    if (!model_inside(point)) return MODEL_OUTSIDE;
    model_rest(p, point);
    memcpy(from, p->state->point, sizeof from);
    for (int k = 0; k < MODEL_PARAMETERS; k++) {
        const double wide = model_box_upper[k] - model_box_lower[k];
        far = fmax(far, fabs(point[k] - from[k]) / (wide > 0 ? wide : 1));
    }
    const int steps = (int)fmax(1, ceil(far * MODEL_STEPS - 1e-9));
    p->parts = steps;
    for (int step = 1; step <= steps; step++) {
        model_between(from, point, (double)step / steps, next);
        if (!model_reached(p, p->state, step == steps ? point : next, reached, 0)) {
            p->begun = 0, p->parts = 1;
            return MODEL_NO_ANSWER;
        }
        model_copy(p->state, reached);
    }
    p->parts = 1;
    return model_told(p, forces, outputs);
}
