
/* S and slack without motions, for bodies on weak springs with given ends. */
static inline void model_spring(model_work *w, double weak, const double *ends) {
    const int m = MODEL_CONDITIONS, r = MODEL_MOTIONS;
    double offset[MODEL_MOTIONS];
    for (int i = 0; i < m; i++)
        for (int k = 0; k < m; k++) {
            w->sprung[i * m + k] = w->schur[i * m + k];
            for (int j = 0; j < r; j++)
                w->sprung[i * m + k] += model_taken[i * r + j] * model_pushes[j] * weak * model_taken[k * r + j];
        }
    for (int j = 0; j < r; j++) offset[j] = ends[j] + model_pushes[j] * weak * w->driving[j];
    for (int i = 0; i < m; i++) w->moved[i] = w->slack[i] - model_taken_by(i, offset);
}

/* Solves with these springs, and computes the motions. */
static inline int model_on_springs(model_work *w, int (*ask)(model_work *), double weak, const double *ends, double *left,
                                   double *sizes) {
    double *schur = w->schur, *slack = w->slack;
    model_spring(w, weak, ends);
    w->schur = w->sprung, w->slack = w->moved, w->held = 1;
    const int found = ask(w);
    w->schur = schur, w->slack = slack, w->held = 0;
    if (!found) return 0;
    model_balance(w, left, sizes, 0);
    for (int j = 0; j < MODEL_MOTIONS; j++) w->motions[j] = ends[j] + model_pushes[j] * weak * left[j];
    return 1;
}

/* Forces and motions for the statuses of an answer, for derivatives: undetermined motions are minimal. */
static inline int model_near(model_work *w, const double *motions) {
    double left[MODEL_MOTIONS], sizes[MODEL_MOTIONS];
    if (model_equalities(w)) return 1;
    if (!model_on_springs(w, model_equalities, MODEL_WEAK, motions, left, sizes)) return 0;
    for (int j = 0; j < MODEL_MOTIONS; j++)
        if (fabs(left[j]) > MODEL_BORNE * sizes[j]) return 0; /* a load acts along a motion without resistance */
    return 1;
}

/* Active set; if its sets do not hold the bodies, weak springs whose ends follow the motions. */
static inline int model_held(model_work *w) {
    static const double weakness[] = {1e3, 1e5, 1e7, 1e9};
    const int m = MODEL_CONDITIONS, r = MODEL_MOTIONS;
    double ends[MODEL_MOTIONS], left[MODEL_MOTIONS], sizes[MODEL_MOTIONS], nothing = 0, soft = 0;
    memcpy(w->start, w->active, m);
    if (model_settled(w)) return 1;
    memcpy(w->active, w->start, m);
    memset(ends, 0, sizeof ends);
    /* forces that close only round-off of the gaps: without loads there are no others to compare with */
    for (int i = 0; i < m; i++) nothing = fmax(nothing, MODEL_NOTHING * fabs(w->slack[i])), soft += fabs(w->schur[i * m + i]) / m;
    nothing /= soft > 0 ? soft : 1;
    for (size_t s = 0; s < sizeof weakness / sizeof *weakness; s++)
        for (int step = 0; step < MODEL_SPRINGS; step++) {
            if (!model_on_springs(w, model_settled, weakness[s], ends, left, sizes)) return 0;
            int close = model_balance(w, left, sizes, nothing);
            double most = 0;
            for (int j = 0; j < r; j++) most = fmax(most, sizes[j]);
            for (int j = 0; j < r; j++) close = close && fabs(left[j]) <= MODEL_BALANCED * most + nothing;
            memcpy(ends, w->motions, sizeof ends), memcpy(w->start, w->active, m);
            if (close || model_settled(w)) return 1;
            memcpy(w->active, w->start, m);
        }
    return 0;
}
