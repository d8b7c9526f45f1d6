
/* Friction next to laws of other plug-ins: Newton's rows for the projection on the disc, as in friction/range.py. */
static inline void model_linear_friction(model_together *t, const double *c, int attempt) {
    static const double probes[] = {0.2, 1, 0.01};
    model_slider *p = t->slider;
    for (int contact = 0; contact < MODEL_CONTACTS; contact++) {
        const int first = model_along[contact], last = model_along[contact + 1], normal = model_normal[contact];
#ifdef MODEL_BENEATH /* laws of the pressures, on ranges before this one */
        const double borne = t->forces[normal] - t->off[normal];
#else
        const double y = t->forces[normal] - c[normal] * t->slack[normal], borne = fmax(y, 0);
        model_close(t, normal, y, c[normal], borne, y > 0);
#endif
        const double bound = model_bounded(p, contact, borne), probe = probes[attempt];
        double stiff = INFINITY, size = 0, length = 0;
        for (int k = first; k < last; k++) stiff = fmin(stiff, c[model_tangential[k]]);
        for (int k = first; k < last; k++) {
            const int row = model_tangential[k];
            size = hypot(size, t->forces[row] - probe * stiff * t->slack[row]);
            length = hypot(length, t->forces[row] - stiff * t->slack[row]);
        }
        const int bears = bound > 0 || borne > 0, slips = bears && size > bound, limited = bound >= p->limit[contact];
        const double share = model_share(bound, length), yields = slips && last - first > 1 ? bound / size : 0;
        for (int k = first; k < last; k++) {
            const int row = model_tangential[k];
            const double own = t->forces[row] - probe * stiff * t->slack[row], d = slips ? own / size : 0;
            const double across = yields * (1 - d * d);
            t->off[row] = t->forces[row] - share * (t->forces[row] - stiff * t->slack[row]);
            t->on_forces[row] = slips ? 1 - across : !bears;
            t->on_slack[row] = slips ? probe * stiff * across : bears ? stiff : 0;
            t->right[row] = slips && limited ? bound * d : 0;
            t->follows[k] = slips && !limited ? -p->coefficient[contact] * d : 0;
            t->mixed[k] = 0;
            if (yields > 0) { /* the other direction of a contact that may turn */
                const int other = model_tangential[k == first ? first + 1 : first];
                t->mixed[k] = yields * d * (t->forces[other] - probe * stiff * t->slack[other]) / size;
            }
            t->active[row] = bears && !slips;
            t->status[row] = bears + 2 * slips + 4 * (d > 0) + 8 * (d < 0) + 16 * limited;
        }
        t->sizes[contact] = probe * stiff;
    }
}

/* Entries of friction in the system. */
static inline void model_add_friction(const model_together *t, double *a, double *x, const unsigned char *known, int left, int size) {
    int place[MODEL_CONDITIONS];
    for (int i = 0; i < MODEL_CONDITIONS; i++) place[i] = -1;
    for (int b = 0; b < left; b++) place[t->place[b]] = b;
    for (int contact = 0; contact < MODEL_CONTACTS; contact++)
        for (int k = model_along[contact]; k < model_along[contact + 1]; k++) {
            const int row = place[model_tangential[k]], normal = model_normal[contact], first = model_along[contact];
            if (row < 0) continue;
            if (t->follows[k] != 0) {
                if (known[normal]) x[row] -= t->follows[k] * t->forces[normal];
                else a[row * size + place[normal]] += t->follows[k];
            }
            if (t->mixed[k] == 0) continue;
            const int other = model_tangential[k == first ? first + 1 : first];
            const double weight = -t->sizes[contact] * t->mixed[k];
            if (known[other]) x[row] -= t->mixed[k] * t->forces[other];
            else a[row * size + place[other]] += t->mixed[k];
            model_add_slack(t, a + row * size, weight, other, left);
            x[row] -= weight * model_slack_of_known(t, known, other);
        }
}

/* Slip after an increment. */
static inline void model_keep_slip(const model_together *t, const model_slip *before, model_slip *after) {
    const int m = MODEL_CONDITIONS;
    model_slider *p = t->slider;
    memset(p->at, 0, 3 * (size_t)m);
    memcpy(p->forces, t->forces, m * sizeof(double));
    for (int i = 0; i < m; i++) p->at[i] = t->active[i], p->left[i] = t->active[i] ? 0 : t->slack[i];
    for (int k = 0; k < MODEL_TANGENTS; k++) p->at[2 * m + model_tangential[k]] = !t->active[model_tangential[k]];
    model_remember(p, before, after);
}

/* Error of an increment by halving it: the squared sticking force of contacts that closed in it, and its work. */
static inline double model_off_friction(const model_state *before, const model_state *half, const model_state *second,
                                        const model_state *whole, double off, double largest) {
    const model_state *ends[] = {before, half, second};
    double held = 0, work = 0, other = 0;
    for (int step = 0; step < 2; step++) {
        double apart = 0;
        for (int k = 0; k < MODEL_CONTACTS; k++) apart = fmax(apart, MODEL_OPEN * fabs(ends[step]->slip.gap[k]));
        for (int k = 0; k < MODEL_TANGENTS; k++) {
            const double force = ends[step + 1]->forces[model_tangential[k]];
            if (ends[step + 1]->slip.pressure[model_owner[k]] > 0 && ends[step]->slip.gap[model_owner[k]] > apart) held += force * force;
        }
    }
    for (int k = 0; k < MODEL_CONTACTS; k++) work += second->slip.work[k], other += whole->slip.work[k];
    const double scale = work + MODEL_PART_OF_WORK * *second->energy;
    return fmax(off + sqrt(held) / largest, fabs(work - other) / (scale > 0 ? scale : 1));
}
