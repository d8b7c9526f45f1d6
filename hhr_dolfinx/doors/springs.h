
/* The plain active set, and where it meets sets that do not hold the bodies weak springs, whose ends follow. */
static inline int model_held(model_work *w) {
    static const double weakness[] = {1e3, 1e5, 1e7, 1e9};
    const int m = MODEL_CONDITIONS, r = MODEL_MOTIONS;
    double *schur = w->schur, *slack = w->slack, ends[MODEL_MOTIONS], left[MODEL_MOTIONS], sizes[MODEL_MOTIONS], offset[MODEL_MOTIONS];
    memcpy(w->start, w->active, m);
    if (model_settled(w)) return 1;
    memcpy(w->active, w->start, m);
    memset(ends, 0, sizeof ends);
    for (size_t s = 0; s < sizeof weakness / sizeof *weakness; s++) {
        for (int i = 0; i < m; i++)
            for (int k = 0; k < m; k++) {
                w->sprung[i * m + k] = schur[i * m + k];
                for (int j = 0; j < r; j++)
                    w->sprung[i * m + k] += model_taken[i * r + j] * model_pushes[j] * weakness[s] * model_taken[k * r + j];
            }
        for (int step = 0; step < MODEL_SPRINGS; step++) {
            for (int j = 0; j < r; j++) offset[j] = ends[j] + model_pushes[j] * weakness[s] * w->driving[j];
            for (int i = 0; i < m; i++) w->moved[i] = slack[i] - model_taken_by(i, offset);
            w->schur = w->sprung, w->slack = w->moved, w->held = 1;
            const int found = model_settled(w);
            w->schur = schur, w->slack = slack, w->held = 0;
            if (!found) return 0;
            double most = 0;
            int close = model_balance(w, left, sizes);
            for (int j = 0; j < r; j++) most = fmax(most, sizes[j]), ends[j] += model_pushes[j] * weakness[s] * left[j];
            for (int j = 0; j < r; j++) close = close && fabs(left[j]) <= MODEL_BALANCED * most;
            memcpy(w->motions, ends, sizeof ends), memcpy(w->start, w->active, m);
            if (close || model_settled(w)) return 1;
            memcpy(w->active, w->start, m);
        }
    }
    return 0;
}
