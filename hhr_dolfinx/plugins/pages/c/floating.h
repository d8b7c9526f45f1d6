
/* Bodies with rigid motions q as unknowns in addition to forces, slack = free slack + S x - G q, G^T x = driving;
   as in contact/floating.py. */
#define MODEL_SINGULAR 1e-8
#define MODEL_UNBALANCED 1e-13
#define MODEL_BALANCED 1e-12
#define MODEL_NOTHING 1e-14
#define MODEL_WEAK 1e5
#define MODEL_BORNE 1e-3
#define MODEL_SPRINGS 30

static inline double model_taken_by(int i, const double *motions) {
    double taken = 0;
    for (int j = 0; j < MODEL_MOTIONS; j++) taken += model_taken[i * MODEL_MOTIONS + j] * motions[j];
    return taken;
}

/* Residual of the balance along each motion under forces, and the size of its terms; 1 if it is round-off. */
static inline int model_balance(const model_work *w, double *left, double *sizes, double nothing) {
    double most = 0;
    for (int j = 0; j < MODEL_MOTIONS; j++) {
        left[j] = w->driving[j], sizes[j] = fabs(w->driving[j]);
        for (int i = 0; i < MODEL_CONDITIONS; i++) {
            const double borne = w->forces[i] * model_taken[i * MODEL_MOTIONS + j];
            left[j] -= borne, sizes[j] += fabs(borne);
        }
        most = fmax(most, model_units[j] * sizes[j]);
    }
    for (int j = 0; j < MODEL_MOTIONS; j++)
        if (!(model_units[j] * (fabs(left[j]) - nothing) <= MODEL_SINGULAR * model_units[j] * sizes[j] + MODEL_UNBALANCED * most))
            return 0;
    return 1;
}

/* Forces, slack and motions for given statuses; 0 if the active contacts do not hold all bodies. */
static inline int model_free_equalities(model_work *w) {
    const int m = MODEL_CONDITIONS, r = MODEL_MOTIONS;
    double *a = w->factored, *x = w->left, *whole = w->whole, *right = w->right, most = 0;
    double left[MODEL_MOTIONS], sizes[MODEL_MOTIONS];
    int n = 0;
    for (int i = 0; i < m; i++)
        if (w->active[i]) w->index[n++] = i;
    const int size = n + r;
    memset(a, 0, sizeof(double) * size * size);
    for (int i = 0; i < n; i++) {
        x[i] = -w->slack[w->index[i]];
        for (int j = 0; j < n; j++) a[i * size + j] = w->schur[w->index[i] * m + w->index[j]];
        for (int j = 0; j < r; j++) {
            a[i * size + n + j] = -model_taken[w->index[i] * r + j] * model_units[j];
            a[(n + j) * size + i] = -a[i * size + n + j];
        }
    }
    for (int j = 0; j < r; j++) x[n + j] = model_units[j] * w->driving[j];
    memcpy(whole, a, sizeof(double) * size * size), memcpy(right, x, sizeof(double) * size);
    if (!model_factored(a, size, w->pivots, x)) return 0;
    for (int i = 0; i < size; i++) most = fmax(most, fabs(right[i]));
    for (int i = 0; i < size; i++) {
        double rest = right[i];
        for (int j = 0; j < size; j++) rest -= whole[i * size + j] * x[j];
        if (!(fabs(rest) <= MODEL_SINGULAR * most)) return 0;
    }
    memset(w->forces, 0, m * sizeof(double));
    for (int i = 0; i < n; i++) w->forces[w->index[i]] = x[i];
    for (int j = 0; j < r; j++) w->motions[j] = model_units[j] * x[n + j];
    if (!model_balance(w, left, sizes, 0)) return 0;
    for (int i = 0; i < m; i++) {
        w->left[i] = w->active[i] ? 0 : w->slack[i] - model_taken_by(i, w->motions);
        for (int j = 0; j < n && !w->active[i]; j++) w->left[i] += w->schur[i * m + w->index[j]] * w->forces[w->index[j]];
    }
    return 1;
}
