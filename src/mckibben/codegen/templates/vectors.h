<% if single %>
#define SINGLE
<% endif %>
/* Vectors `V` of W real numbers, `I` and `U` of integers, `D` and `L` of their 64-bit forms; masks are integers. */
#ifndef __clang__
/* for long blocks: scheduling before register allocation, without passes that are slow to compile */
#pragma GCC optimize("schedule-insns", "sched-pressure", "ira-region=one", "no-gcse", "no-tree-pre")
#endif
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#ifdef SINGLE
#define REAL float
#define WHOLE int32_t
#define WHOLE_POSITIVE uint32_t
#define OF_REAL(name) name##f
#else
#define REAL double
#define WHOLE int64_t
#define WHOLE_POSITIVE uint64_t
#define OF_REAL(name) name
#endif
#if defined(__AVX512F__)
enum { W = 64 / sizeof(REAL) };
#elif defined(__AVX2__)
enum { W = 32 / sizeof(REAL) };
#else
enum { W = 16 / sizeof(REAL) };
#endif
const int64_t width = ${count} * W; /* vectors of two registers would take 1.8 to 4 times as long as two vectors in turns */

#define VECTOR(kind, name) typedef kind name __attribute__((vector_size(sizeof(kind) * W)));
VECTOR(REAL, V) VECTOR(WHOLE, I) VECTOR(WHOLE_POSITIVE, U) VECTOR(double, D) VECTOR(int64_t, L)

#define INLINE static inline __attribute__((always_inline, unused))
INLINE V real(double x) { return (REAL)x - (V){0}; }
INLINE I integer(int64_t x) { return (WHOLE)x - (I){0}; }
INLINE I mask(bool x) { return integer(-(int64_t)x); }
INLINE V pick(I c, V x, V y) { return (V)((c & (I)x) ^ (~c & (I)y)); } /* with ^ a blend in gcc, with | two operations */
INLINE I pick_integer(I c, I x, I y) { return (c & x) ^ (~c & y); }
INLINE V load(const double *x) { D r; memcpy(&r, x, sizeof r); return __builtin_convertvector(r, V); }
INLINE I load_integer(const int64_t *x) { L r; memcpy(&r, x, sizeof r); return __builtin_convertvector(r, I); }
INLINE I load_mask(const int64_t *x) { return load_integer(x) != 0; }
INLINE void store(double *to, V x) { D r = __builtin_convertvector(x, D); memcpy(to, &r, sizeof r); }
INLINE void store_integer(int64_t *to, I x) { L r = __builtin_convertvector(x, L); memcpy(to, &r, sizeof r); }
INLINE void store_mask(int64_t *to, I x) { store_integer(to, x & 1); }
INLINE bool any(I c) { WHOLE r = 0; for (int i = 0; i < W; ++i) r |= c[i]; return r != 0; }
INLINE V v_maximum(V x, V y) { return pick(~(x <= y) & (y == y), x, y); }
INLINE V v_minimum(V x, V y) { return pick(~(x >= y) & (y == y), x, y); }
INLINE V v_absolute(V x) { return (V)((I)x & (WHOLE)(UINT64_MAX >> (65 - 8 * sizeof(REAL)))); }
INLINE V v_sign(V x) { return pick(x > 0, real(1), pick(x < 0, real(-1), real(0))); }
INLINE I v_isfinite(V x) { return x - x == 0; }
#define EACH(name, f) INLINE V name(V x) { V r; for (int i = 0; i < W; ++i) r[i] = f(x[i]); return r; }
EACH(v_sqrt, OF_REAL(__builtin_sqrt)) EACH(v_rint, OF_REAL(__builtin_rint))
EACH(v_floor, OF_REAL(__builtin_floor)) EACH(v_ceil, OF_REAL(__builtin_ceil))
EACH(v_exp, exp) EACH(v_expm1, expm1) EACH(v_log, log) EACH(v_log1p, log1p) EACH(v_sin, sin) EACH(v_cos, cos)
EACH(v_tan, tan) EACH(v_asin, asin) EACH(v_acos, acos) EACH(v_atan, atan) EACH(v_sinh, sinh) EACH(v_cosh, cosh)
EACH(v_tanh, tanh) EACH(v_cbrt, cbrt)
#define PAIR(name, f) INLINE V name(V x, V y) { V r; for (int i = 0; i < W; ++i) r[i] = f(x[i], y[i]); return r; }
PAIR(v_pow, pow) PAIR(v_atan2, atan2) PAIR(v_fmod, fmod)
#ifndef SINGLE
typedef float F __attribute__((vector_size(4 * W)));
typedef int32_t J __attribute__((vector_size(4 * W)));
INLINE V v_single(V x) { return __builtin_convertvector(__builtin_convertvector(x, F), V); }
INLINE V v_from_bits_32(I x) { return __builtin_convertvector((F)__builtin_convertvector(x, J), V); }
#endif
