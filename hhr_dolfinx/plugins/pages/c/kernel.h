/* MODEL_TITLE: a contact problem, condensed. C99, no libraries but libm; written by hhr_dolfinx.

   The contact forces at a point of the parameters are those of the finite element model, and solve

       S(p) x + s(p) >= 0,  x >= 0,  x . (S(p) x + s(p)) = 0.

       model_work *work = model_new();
       double point[MODEL_PARAMETERS] = {...}, forces[MODEL_CONDITIONS], outputs[MODEL_OUTPUTS];
       if (model_solve(work, point, forces, outputs) == MODEL_DONE) ...
       model_free(work);

   With friction or inelastic bodies answers depend on the path. Use instead: model_path_new; model_begin, with
   proportional loading to a point; model_go, one increment each time; and model_path_free. Where laws depend on rates,
   set path->seconds, the duration of an increment or of the first load: it is 1 otherwise.

   One work, or path, for each thread. Include it in one file, or in several: all is static. */
#ifndef model_HEADER
#define model_HEADER
#ifdef __cplusplus
#error "compile what includes this header as C99, and call it from C++ through functions of your own"
#endif
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#ifndef MODEL_AT /* a page has other ones */
typedef double (*model_function)(const double *); /* of the parameters */
#define MODEL_AT(function, point) (function)(point)
#define MODEL_REACHED(state) (void)(state) /* a state of proportional loading */
#endif

typedef struct {
    model_function value; /* a formula, or a pressure up to a parameter: */
    const double *positions, *slopes;
    double constant;
    int count, degree, extent;
} model_amplitude;
typedef struct { /* an elastic constant, and the open interval in which it must lie */
    model_function value;
    double low, high;
    int count;
} model_limit;
typedef struct {
    const int *axes, *levels;
    const double *lower, *upper, *nodes, *weights, *modes;
    int axes_count, nodes_count, grid, rank;
} model_interpolant;
typedef struct {
    model_interpolant interpolant;
    model_function factor;
    const int *conditions, *terms;
    const double *columns;
    int count, terms_count, forced;
} model_part;
typedef struct {
    const double *forces, *terms, *motions, *areas, *counted; /* weights of a linear one; areas of the others */
    const int *conditions;
    double offset, factor, least;
    int count, largest;
    const double *modes, *given, *pushed, *forced; /* of a displacement of inelastic bodies */
    const double *half; /* of a quadratic one: second derivatives along forces and theta, the lower half by rows */
    const double *stressed, *shares; /* of stress: rows of cells along forces and theta; shares of cells in a mean */
    int components, principal; /* of a stress; which of the principal values of a tensor, 0 for the norms of rows */
} model_output;

/* The smaller and the larger one of two numbers; NaN if either is NaN. */
static inline double model_min(double a, double b) { return a != a || b != b ? NAN : a < b ? a : b; }
static inline double model_max(double a, double b) { return a != a || b != b ? NAN : a > b ? a : b; }

/* A table of pairs (x, y) with linear interpolation: values are x, and then the pairs. */
static inline double model_table(int count, const double *values) {
    for (int k = 1; k + 3 < count; k += 2)
        if (values[0] >= values[k] && values[0] <= values[k + 2])
            return values[k + 1] + (values[k + 3] - values[k + 1]) * (values[0] - values[k]) / (values[k + 2] - values[k]);
    return NAN;
}

typedef struct {
    model_function coefficient, limit; /* of friction; NULL without a bound */
} model_law;
typedef struct {
    model_function value;
} model_modulus;
typedef struct { /* a law of bodies as a program: rows of an operation, its result and its operands; see programs.h */
    const int *rows, *ends, *outputs, *output_ends, *kinds;
    const double *numbers, *low, *high; /* the last two are limits of its constants */
    int unknowns, memory, constants, numbers_count, limited;
} model_program;
typedef struct {
    const model_function *constants; /* E, the ratio of Poisson, and those of its law */
    const double *places;                       /* of its points, if constants vary in space */
    const double *grading;                      /* factor of C at its points; NULL for 1 */
    const double *elastic, *compliance;         /* C and C^-1 in the middle of the box, for the grading 1 */
    const model_program *law;                   /* NULL for an elastic body */
    int points, constants_count, coordinates;
} model_body;

typedef struct { /* a law on some conditions: its number, 0 for unilateral contact and -1 for friction */
    const int *rows;
    const double *numbers;          /* of each row, (count, width) */
    const model_function *formulas; /* of the parameters */
    int law, count, width, formulas_count, first_formula;
    int memory, first, remembers; /* numbers for each row, and the first of them */
} model_range;

/*DATA*/
#define MODEL_PATHS (MODEL_RUBS || MODEL_FLOWS || MODEL_REMEMBERS)

/* CHANGED: a modulus or a law, within a path */
enum { MODEL_DONE = 0, MODEL_OUTSIDE = 1, MODEL_NO_ANSWER = 2, MODEL_CHANGED = 3 };

/* Scales of round-off by contact: pairs[i] is the contact of condition i. */
#define MODEL_TOLERANCE 1e-11
#define MODEL_ROUND_OFF 1e-15
#define MODEL_MOST 1000
#define MODEL_STEP 1e-5
#define MODEL_KEPT 64

/* Rows of numbers in one block, which starts with zeros and ends with some bytes; NULL without memory. */
typedef struct {
    double **row;
    size_t count;
} model_row;
#define MODEL_ROWS(rows) (rows), sizeof(rows) / sizeof *(rows)
static inline double *model_block(const model_row *rows, size_t count, size_t bytes, size_t *size) {
    *size = bytes;
    for (size_t k = 0; k < count; k++) *size += rows[k].count * sizeof(double);
    double *block = calloc(1, *size), *next = block;
    for (size_t k = 0; block && k < count; next += rows[k++].count) *rows[k].row = next;
    return block;
}

#define model_copy(to, from) memcpy((to)->block, (from)->block, (to)->size)

typedef struct {
    double *block, *schur, *slack, *theta, *factored, *forces, *left, *along, *sum, *gaps;
#if MODEL_FLOATS
    double *whole, *right, *sprung, *moved, *driving, *motions;
    unsigned char *start;
    int held; /* by springs */
#endif
    int *index, *pivots;
    unsigned char *active, *seen;
    int started;
#if MODEL_RANGED
    struct model_together *together;
#endif
    const double *correction, *gives; /* of inelastic bodies */
} model_work;

#if MODEL_RANGED
static inline void model_together_free(struct model_together *t);
#endif
static inline void model_free(model_work *w) {
    if (!w) return;
#if MODEL_RANGED
    model_together_free(w->together);
#endif
    free(w->block), free(w->index), free(w->pivots), free(w->active), free(w->seen), free(w);
}

/* Work arrays; NULL without memory. */
static inline model_work *model_new(void) {
    const size_t m = MODEL_CONDITIONS, t = MODEL_TERMS, n = m + MODEL_MOTIONS;
    model_work *w = calloc(1, sizeof *w);
    if (!w) return NULL;
    const model_row rows[] = {{&w->schur, m * m}, {&w->factored, n * n}, {&w->slack, m}, {&w->theta, t}, {&w->forces, m},
                              {&w->left, n}, {&w->along, MODEL_LONGEST}, {&w->sum, m * (m + 1) / 2}, {&w->gaps, m * t},
#if MODEL_FLOATS
                              {&w->whole, n * n}, {&w->right, n}, {&w->sprung, m * m}, {&w->moved, m},
                              {&w->driving, MODEL_MOTIONS}, {&w->motions, MODEL_MOTIONS},
#endif
    };
    size_t size;
    w->block = model_block(MODEL_ROWS(rows), m, &size);
    w->index = malloc(m * sizeof(int)), w->pivots = malloc(n * sizeof(int)), w->active = malloc(m);
    w->seen = malloc(m * MODEL_KEPT);
    if (w->block && w->index && w->pivots && w->active && w->seen) {
#if MODEL_FLOATS
        w->start = (unsigned char *)w->block + size - m;
#endif
        return w;
    }
    model_free(w);
    return NULL;
}

/* A pressure up to a parameter; returns how many terms it has. */
static inline int model_coverage(const model_amplitude *item, const double *point, double *out) {
    const int degree = item->degree, edges = (item->count - 1) / degree;
    const double *line = item->positions, end = point[item->extent];
    int edge = 0;
    while (edge < edges - 1 && line[degree * (edge + 1)] < end) edge++;
    const double start = line[degree * edge], length = line[degree * (edge + 1)] - start;
    const double s = fmin(fmax((end - start) / length, 0), 1), cube = 2 * s * s * s / 3;
    double size = item->constant;
    for (int k = 0; k < MODEL_PARAMETERS; k++) size += item->slopes[k] * point[k];
    out[edge] = size;
    double *part = out + edges + degree * edge;
    if (degree == 1) {
        part[0] = size * length * (s - s * s / 2), part[1] = size * length * s * s / 2;
    } else {
        part[0] = size * length * (s - 1.5 * s * s + cube), part[1] = size * length * (2 * s * s - 2 * cube);
        part[2] = size * length * (cube - s * s / 2);
    }
    return edges + item->count;
}

static inline void model_set_theta(model_work *w, const double *point) {
    memset(w->theta, 0, MODEL_TERMS * sizeof(double));
    for (int t = 0; t < MODEL_AFFINE; t++) {
        w->theta[t] = model_constant[t];
        for (int k = 0; k < MODEL_PARAMETERS; k++) w->theta[t] += model_slopes[t * MODEL_PARAMETERS + k] * point[k];
    }
    int place = MODEL_AFFINE;
    for (int k = 0; k < MODEL_OTHERS; k++) {
        const model_amplitude *item = &model_others[k];
        if (item->value) w->theta[place++] = MODEL_AT(item->value, point);
        else place += model_coverage(item, point, w->theta + place);
    }
}

/* Components of an interpolation along its modes, Newton's form on nested nodes. */
static inline void model_set_along(const model_interpolant *part, const double *point, double *along) {
    double tables[MODEL_PARAMETERS][MODEL_NODES + 1];
    for (int a = 0; a < part->axes_count; a++) {
        const double x = 2 * (point[part->axes[a]] - part->lower[a]) / (part->upper[a] - part->lower[a]) - 1;
        for (int k = 0; k < part->nodes_count; k++) {
            tables[a][k] = 1;
            for (int j = 0; j < k; j++) tables[a][k] *= (x - part->nodes[j]) / (part->nodes[k] - part->nodes[j]);
        }
    }
    for (int i = 0; i < part->rank; i++) along[i] = 0;
    for (int j = 0; j < part->grid; j++) {
        double h = 1;
        for (int a = 0; a < part->axes_count; a++) h *= tables[a][part->levels[j * part->axes_count + a]];
        for (int i = 0; i < part->rank; i++) along[i] += part->weights[i * part->grid + j] * h;
    }
}

/* Add one connected component to S and to the free slack. */
static inline void model_add(model_work *w, const model_part *part, const double *point) {
    const int m = MODEL_CONDITIONS, c = part->count, half = c * (c + 1) / 2, rank = part->interpolant.rank;
    const double compliance = part->factor ? 1 / MODEL_AT(part->factor, point) : 1;
    model_set_along(&part->interpolant, point, w->along);
    memset(w->sum, 0, half * sizeof(double));
    for (int k = 0; k < rank; k++)
        for (int i = 0; i < half; i++) w->sum[i] += compliance * w->along[k] * part->interpolant.modes[(size_t)k * half + i];
    for (int i = 0, k = 0; i < c; i++)
        for (int j = 0; j <= i; j++, k++) {
            w->schur[part->conditions[i] * m + part->conditions[j]] += w->sum[k];
            if (i != j) w->schur[part->conditions[j] * m + part->conditions[i]] += w->sum[k];
        }
    for (int t = 0; t < part->terms_count; t++) {
        const double weight = w->theta[part->terms[t]] * (t < part->forced ? compliance : -1);
        if (weight == 0) continue;
        for (int i = 0; i < c; i++) {
            double moved = 0;
            for (int k = 0; k < rank; k++) moved += part->columns[((size_t)t * c + i) * rank + k] * w->along[k];
            w->slack[part->conditions[i]] -= weight * moved;
        }
    }
}

/* 1 if the elastic constants are admissible at a point: interpolation does not evaluate them. */
static inline int model_possible(const double *point) {
    for (int k = 0; k < MODEL_LIMITS; k++) {
        const double value = MODEL_AT(model_limits[k].value, point);
        if (!(value > model_limits[k].low && value < model_limits[k].high)) return 0;
    }
    return 1;
}

/* S and the free slack at a point; 0 if they are not finite. */
static inline int model_set_contact(model_work *w, const double *point) {
    const int m = MODEL_CONDITIONS, terms = MODEL_TERMS;
    const double *gaps = model_gaps;
    if (!model_possible(point)) return 0;
    model_set_theta(w, point);
    if (MODEL_CONSTANT && !w->started)
        for (int i = 0, k = 0; i < m; i++)
            for (int j = 0; j <= i; j++, k++) w->schur[i * m + j] = model_schur[k], w->schur[j * m + i] = model_schur[k];
    if (!MODEL_CONSTANT) memset(w->schur, 0, sizeof(double) * m * m);
    if (model_reshaped.rank) {
        model_set_along(&model_reshaped, point, w->along);
        memset(w->gaps, 0, sizeof(double) * m * terms);
        for (int k = 0; k < model_reshaped.rank; k++)
            for (int i = 0; i < m * terms; i++) w->gaps[i] += w->along[k] * model_reshaped.modes[(size_t)k * m * terms + i];
        gaps = w->gaps;
    }
    for (int i = 0; i < m; i++) {
        w->slack[i] = 0;
        for (int t = 0; t < terms; t++) w->slack[i] += gaps[i * terms + t] * w->theta[t];
    }
    for (int k = 0; k < MODEL_PARTS; k++) model_add(w, &model_parts[k], point);
#if MODEL_FLOATS
    for (int j = 0; j < MODEL_MOTIONS; j++) {
        w->driving[j] = 0;
        for (int t = 0; t < terms; t++) w->driving[j] += model_driving[j * terms + t] * w->theta[t];
    }
#endif
    for (int t = 0; t < terms; t++)
        if (!isfinite(w->theta[t])) return 0;
    for (int i = 0; i < m; i++)
        if (!isfinite(w->slack[i]) || !isfinite(w->schur[i * m + i])) return 0;
    return 1;
}

/* LU with the largest pivots, in place; 0 if singular. */
static inline int model_lu(double *a, int n, int *pivots) {
    for (int k = 0; k < n; k++) {
        int best = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(a[i * n + k]) > fabs(a[best * n + k])) best = i;
        pivots[k] = best;
        if (!(fabs(a[best * n + k]) > 0)) return 0;
        if (best != k)
            for (int j = 0; j < n; j++) {
                const double swap = a[k * n + j];
                a[k * n + j] = a[best * n + j], a[best * n + j] = swap;
            }
        for (int i = k + 1; i < n; i++) {
            const double share = (a[i * n + k] /= a[k * n + k]);
            if (share != 0)
                for (int j = k + 1; j < n; j++) a[i * n + j] -= share * a[k * n + j];
        }
    }
    return 1;
}

/* A solution by LU, in place. */
static inline void model_lu_solved(const double *a, int n, const int *pivots, double *x) {
    for (int k = 0; k < n; k++) {
        const double swap = x[pivots[k]];
        x[pivots[k]] = x[k], x[k] = swap;
    }
    for (int i = 0; i < n; i++)
        for (int j = 0; j < i; j++) x[i] -= a[i * n + j] * x[j];
    for (int i = n - 1; i >= 0; i--) {
        for (int j = i + 1; j < n; j++) x[i] -= a[i * n + j] * x[j];
        x[i] /= a[i * n + i];
    }
}

/* LU and one solution; 0 if singular. */
static inline int model_factored(double *a, int n, int *pivots, double *x) {
    if (!model_lu(a, n, pivots)) return 0;
    model_lu_solved(a, n, pivots, x);
    return 1;
}

#if MODEL_FLOWS
/* Part of an output that reads displacements: of corrections, of imposed ones, and by part of forces and loads. */
static inline double model_displaced(const model_work *w, const model_output *item) {
    double value = 0;
    if (!item->modes) return 0;
    for (int j = 0; j < MODEL_MODES; j++) value += item->modes[j] * w->correction[j];
    for (int t = 0; t < MODEL_TERMS; t++) value += item->given[t] * w->theta[t];
    for (int q = 0; q < MODEL_SHARES; q++) {
        double elastic = 0;
        for (int t = 0; t < MODEL_TERMS; t++) elastic += item->forced[q * MODEL_TERMS + t] * w->theta[t];
        for (int i = 0; i < MODEL_CONDITIONS; i++) elastic -= item->pushed[q * MODEL_CONDITIONS + i] * w->forces[i];
        value += w->gives[q] * elastic;
    }
    return value;
}
#endif

/* The first, second or third of the eigenvalues of a tensor in Kelvin's notation from the largest on, by Jacobi's
   rotations. */
static inline double model_principal(const double *tensor, int components, int which) {
    const double root = sqrt(0.5), xz = components > 4 ? root * tensor[4] : 0, yz = components > 4 ? root * tensor[5] : 0;
    double a[3][3] = {{tensor[0], root * tensor[3], xz}, {root * tensor[3], tensor[1], yz}, {xz, yz, tensor[2]}};
    for (int sweep = 0; sweep < 30; sweep++) {
        for (int p = 0; p < 2; p++) {
            for (int q = p + 1; q < 3; q++) {
                if (a[p][q] == 0) continue;
                const double ratio = (a[q][q] - a[p][p]) / (2 * a[p][q]);
                const double tangent = (ratio < 0 ? -1 : 1) / (fabs(ratio) + sqrt(ratio * ratio + 1));
                const double cosine = 1 / sqrt(tangent * tangent + 1), sine = tangent * cosine;
                for (int k = 0; k < 3; k++) {
                    const double first = a[k][p], second = a[k][q];
                    a[k][p] = cosine * first - sine * second, a[k][q] = sine * first + cosine * second;
                }
                for (int k = 0; k < 3; k++) {
                    const double first = a[p][k], second = a[q][k];
                    a[p][k] = cosine * first - sine * second, a[q][k] = sine * first + cosine * second;
                }
                a[p][q] = a[q][p] = 0;
            }
        }
    }
    const double x = a[0][0], y = a[1][1], z = a[2][2];
    const double most = model_max(x, model_max(y, z)), least = model_min(x, model_min(y, z));
    return which == 1 ? most : which == 3 ? least : model_max(model_min(x, y), model_min(model_max(x, y), z));
}

/* The largest norm of the rows of cells, their mean by shares, or a principal value of the rows of one tensor. */
static inline double model_stress(const model_work *w, const model_output *item) {
    double value = 0;
    const double *row = item->stressed;
    for (int cell = 0; cell < item->count; cell++) {
        double tensor[6], square = 0;
        for (int c = 0; c < item->components; c++) {
            double stress = 0;
            for (int i = 0; i < MODEL_CONDITIONS; i++) stress += *row++ * w->forces[i];
            for (int t = 0; t < MODEL_TERMS; t++) stress += *row++ * w->theta[t];
            tensor[c] = stress, square += stress * stress;
        }
        if (item->principal) return model_principal(tensor, item->components, item->principal);
        value = item->shares ? value + item->shares[cell] * sqrt(square) : model_max(value, sqrt(square));
    }
    return value;
}

static inline void model_read(const model_work *w, double *outputs) {
    for (int k = 0; k < MODEL_OUTPUTS; k++) {
        const model_output *item = &model_outputs[k];
        double value = 0, most = -DBL_MAX, loaded = 0;
        if (item->half) {
            const double *row = item->half;
            for (int i = 0; i < MODEL_CONDITIONS + MODEL_TERMS; row += ++i) {
                const double x = i < MODEL_CONDITIONS ? w->forces[i] : w->theta[i - MODEL_CONDITIONS];
                double slope = row[i] * x / 2;
                for (int j = 0; j < i; j++)
                    slope += row[j] * (j < MODEL_CONDITIONS ? w->forces[j] : w->theta[j - MODEL_CONDITIONS]);
                value += slope * x;
            }
            outputs[k] = value;
            continue;
        }
        if (item->stressed) {
            outputs[k] = model_stress(w, item);
            continue;
        }
        if (item->forces) {
            for (int i = 0; i < MODEL_CONDITIONS; i++) value += item->forces[i] * w->forces[i];
            for (int t = 0; t < MODEL_TERMS; t++) value += item->terms[t] * w->theta[t];
#if MODEL_FLOATS
            for (int j = 0; j < MODEL_MOTIONS && item->motions; j++) value += item->motions[j] * w->motions[j];
#endif
#if MODEL_FLOWS
            value += model_displaced(w, item);
#endif
            outputs[k] = value;
            continue;
        }
        for (int i = 0; i < item->count; i++) most = fmax(most, w->forces[item->conditions[i]] / item->areas[i]);
        for (int i = 0; i < item->count && !item->largest; i++)
            if (most > 0 && w->forces[item->conditions[i]] / item->areas[i] > item->least * most) loaded += item->counted[i];
        outputs[k] = item->largest ? most : item->offset + item->factor * loaded;
    }
}

#if MODEL_PATHS
/* 1 if the fixed parameters of a path are inside the box at a point. */
static inline int model_stays(const double *point) {
    for (int k = 0; k < MODEL_FIXED_COUNT; k++)
        if (!(point[model_fixed[k]] >= model_lower[model_fixed[k]] && point[model_fixed[k]] <= model_upper[model_fixed[k]])) return 0;
    return 1;
}

/* Start of a path: the point of the box nearest to zero, with the fixed parameters of a point. */
static inline void model_start(const double *point, double *from) {
    for (int k = 0; k < MODEL_PARAMETERS; k++) from[k] = fmin(fmax(0, model_box_lower[k]), model_box_upper[k]);
    for (int k = 0; k < MODEL_FIXED_COUNT; k++) from[model_fixed[k]] = point[model_fixed[k]];
}

static inline int model_inside(const double *point) {
    for (int k = 0; k < MODEL_PARAMETERS; k++)
        if (!(point[k] >= model_lower[k] && point[k] <= model_upper[k])) return 0;
    return 1;
}

static inline void model_between(const double *from, const double *to, double share, double *out) {
    for (int k = 0; k < MODEL_PARAMETERS; k++) out[k] = from[k] + (to[k] - from[k]) * share;
}
#endif

/*FLOATING*/
#if MODEL_RUBS
/*FRICTION*/
#endif
#if MODEL_RANGED
/*RANGES*/
#elif !MODEL_RUBS
/* Forces and slack for given statuses; 0 if their set is singular. */
static inline int model_equalities(model_work *w) {
#if MODEL_FLOATS
    if (!w->held) return model_free_equalities(w);
#endif
    const int m = MODEL_CONDITIONS;
    double *x = w->left; /* until the slack is known */
    int n = 0;
    for (int i = 0; i < m; i++)
        if (w->active[i]) w->index[n++] = i;
    for (int i = 0; i < n; i++) {
        x[i] = -w->slack[w->index[i]];
        for (int j = 0; j < n; j++) w->factored[i * n + j] = w->schur[w->index[i] * m + w->index[j]];
    }
    if (!model_factored(w->factored, n, w->pivots, x)) return 0;
    memset(w->forces, 0, m * sizeof(double));
    for (int i = 0; i < n; i++) w->forces[w->index[i]] = x[i];
    for (int i = 0; i < m; i++) {
        w->left[i] = w->slack[i];
        if (w->active[i]) w->left[i] = 0;
        else
            for (int j = 0; j < n; j++) w->left[i] += w->schur[i * m + w->index[j]] * w->forces[w->index[j]];
    }
    return 1;
}

/* Switches the statuses of conditions that pull or penetrate by more than round-off of their contact, all of them
   or the first one; returns how many there were. */
static inline int model_corrected(model_work *w, int one) {
    const int m = MODEL_CONDITIONS;
    double force[MODEL_GROUPS], size[MODEL_GROUPS], most = 0, closing = 0;
    for (int g = 0; g < MODEL_GROUPS; g++) force[g] = -DBL_MAX, size[g] = 0;
    for (int i = 0; i < m; i++) {
        const int g = model_pairs[i];
        force[g] = fmax(force[g], w->forces[i]), size[g] = fmax(size[g], fabs(w->slack[i]));
        most = fmax(most, w->forces[i]), closing = fmax(closing, -w->slack[i]);
    }
    if (MODEL_GROUPS == 1) most = closing = 0;
    int found = 0;
    for (int i = 0; i < m; i++) {
        const int g = model_pairs[i];
        const double pulling = MODEL_TOLERANCE * force[g] + MODEL_ROUND_OFF * most;
        const double through = MODEL_TOLERANCE * size[g] + MODEL_ROUND_OFF * closing;
        if (!(w->forces[i] < -pulling || w->left[i] < -through)) continue;
        if (!one || !found) w->active[i] ^= 1;
        found++;
    }
    return found;
}

static inline int model_finite(const model_work *w) {
    for (int i = 0; i < MODEL_CONDITIONS; i++)
        if (!isfinite(w->forces[i])) return 0;
    return 1;
}

/* Active set: all wrong statuses at once, or, if sets repeat, the first wrong one alone (Murty 1974). */
static inline int model_settled(model_work *w) {
    const int m = MODEL_CONDITIONS;
    int one = 0, kept = 0;
    for (int iteration = 0; iteration < MODEL_MOST; iteration++) {
        if (!model_equalities(w)) {
            if (one) return 0;
            one = 1, kept = 0;
            memset(w->active, 0, m);
            continue;
        }
        for (int k = 0; !one && k < kept && k < MODEL_KEPT; k++)
            if (!memcmp(w->seen + (size_t)k * m, w->active, m)) one = 1;
        memcpy(w->seen + (size_t)(kept++ % MODEL_KEPT) * m, w->active, m);
        if (!model_corrected(w, one)) return model_finite(w);
    }
    return 0;
}

#endif

#if MODEL_FLOWS
#if !MODEL_RUBS
/*SPRINGS*/
#endif
/*FLOW*/
#elif !MODEL_PATHS
#if !MODEL_RANGED
/*SPRINGS*/
#endif
/* Contact forces, (MODEL_CONDITIONS), and outputs, (MODEL_OUTPUTS), at a point, (MODEL_PARAMETERS); either may be NULL.
   Initial statuses are those of the previous answer. */
static inline int model_solve(model_work *w, const double *point, double *forces, double *outputs) {
    for (int k = 0; k < MODEL_PARAMETERS; k++)
        if (!(point[k] >= model_lower[k] && point[k] <= model_upper[k])) return MODEL_OUTSIDE;
    if (!model_set_contact(w, point)) {
        w->started = 0;
        return MODEL_NO_ANSWER;
    }
#if !MODEL_RANGED
    if (!w->started)
        for (int i = 0; i < MODEL_CONDITIONS; i++) w->active[i] = w->slack[i] < 0;
#endif
#if MODEL_RANGED
    w->started = model_answered_together(w, point);
#elif MODEL_FLOATS
    w->started = model_held(w);
#else
    w->started = model_settled(w);
#endif
    if (!w->started) return MODEL_NO_ANSWER;
    if (forces) memcpy(forces, w->forces, MODEL_CONDITIONS * sizeof(double));
    if (outputs) model_read(w, outputs);
    return MODEL_DONE;
}

/* Derivatives of the outputs along the parameters, (MODEL_OUTPUTS, MODEL_PARAMETERS), by central differences on the
   statuses of the last answer, which was at this point; if a status is about to change they are one-sided. Those with laws of
   plug-ins are differences of answers. */
static inline int model_derivatives(model_work *w, const double *point, double *slopes) {
    double there[MODEL_PARAMETERS], ends[2][MODEL_OUTPUTS + 1];
    if (!w->started) return MODEL_NO_ANSWER;
    memcpy(there, point, sizeof there);
#if MODEL_FLOATS && !MODEL_RANGED
    double motions[MODEL_MOTIONS];
    memcpy(motions, w->motions, sizeof motions);
#endif
    for (int k = 0; k < MODEL_PARAMETERS; k++) {
        const double step = MODEL_STEP * (model_upper[k] - model_lower[k]);
        const double low = fmax(model_lower[k], point[k] - step), high = fmin(model_upper[k], point[k] + step);
        for (int end = 0; end < 2; end++) {
            there[k] = end ? high : low;
            if (!model_set_contact(w, there)) return MODEL_NO_ANSWER;
#if MODEL_RANGED
            if (!model_answered_together(w, there)) return MODEL_NO_ANSWER;
#elif MODEL_FLOATS
            if (!model_near(w, motions)) return MODEL_NO_ANSWER;
#else
            if (!model_equalities(w)) return MODEL_NO_ANSWER;
#endif
            model_read(w, ends[end]);
        }
        for (int i = 0; i < MODEL_OUTPUTS; i++)
            slopes[i * MODEL_PARAMETERS + k] = (ends[1][i] - ends[0][i]) / (high - low);
        there[k] = point[k];
    }
    return MODEL_DONE;
}
#endif

#if MODEL_PATHS
/* An increment from the current state to a point, with the moduli and laws of the beginning. Without convergence the state
   does not change. */
static inline int model_go(model_path *p, const double *point, double *forces, double *outputs) {
    model_state *reached = &p->pool[MODEL_LAST];
    if (!p->begun) return MODEL_NO_ANSWER;
    if (!model_inside(point)) return MODEL_OUTSIDE;
    for (int k = 0; k < MODEL_FIXED_COUNT; k++)
        if (point[model_fixed[k]] != p->state->point[model_fixed[k]]) return MODEL_CHANGED;
    if (!model_reached(p, p->state, point, reached, 0)) return MODEL_NO_ANSWER;
    model_copy(p->state, reached);
    return model_told(p, forces, outputs);
}
#endif
#endif
