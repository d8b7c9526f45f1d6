/* Functions that WebAssembly has; the others are those of the page. */
#ifndef FREESTANDING_MATH
#define FREESTANDING_MATH
#define INFINITY __builtin_inf()
#define HUGE_VAL __builtin_inf()
#define NAN __builtin_nan("")
#define isfinite(x) __builtin_isfinite(x)
#define isinf(x) __builtin_isinf(x)
#define isnan(x) __builtin_isnan(x)
#define fabs(x) __builtin_fabs(x)
#define sqrt(x) __builtin_sqrt(x)
#define floor(x) __builtin_floor(x)
#define ceil(x) __builtin_ceil(x)
static inline __attribute__((always_inline)) double fmax(double a, double b) { return a > b || b != b ? a : b; }
static inline __attribute__((always_inline)) double fmin(double a, double b) { return a < b || b != b ? a : b; }
static inline double ldexp(double x, int power) {
    for (; power > 0; power--) x *= 2;
    for (; power < 0; power++) x /= 2;
    return x;
}
#define OF_PAGE(name) __attribute__((import_module("env"), import_name(#name)))
OF_PAGE(exp) double exp(double);
OF_PAGE(log) double log(double);
OF_PAGE(sin) double sin(double);
OF_PAGE(cos) double cos(double);
OF_PAGE(tan) double tan(double);
OF_PAGE(asin) double asin(double);
OF_PAGE(acos) double acos(double);
OF_PAGE(atan) double atan(double);
OF_PAGE(sinh) double sinh(double);
OF_PAGE(cosh) double cosh(double);
OF_PAGE(tanh) double tanh(double);
OF_PAGE(pow) double pow(double, double);
OF_PAGE(atan2) double atan2(double, double);
OF_PAGE(hypot) double hypot(double, double);
#endif
