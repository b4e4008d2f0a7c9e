/* Apply a calibration made with imufield, in C99 and C++, without any library.
 *
 *   accelerometer  N - raw_zero = K (s + b) + K2 s^2, s = T a    (or K2 a^2: quadratic_on_body_axes)
 *   gyroscope      w = M (N - offset - G a)
 *
 * N raw output (increments divided by their interval), a specific force in m/s^2, w angular rate in rad/s, body frame.
 * Nothing is allocated and no state is kept; every function may be called from several threads.
 * Define IMUFIELD_REAL as float before including this file where the processor has no double.
 */
#ifndef IMUFIELD_APPLY_H
#define IMUFIELD_APPLY_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifndef IMUFIELD_REAL
#define IMUFIELD_REAL double
#endif
typedef IMUFIELD_REAL imufield_real;

enum {
    IMUFIELD_OK = 0,
    IMUFIELD_NO_SOLUTION = -1,    /* no specific force gives this output */
    IMUFIELD_NO_GYROSCOPE = -2,   /* these parameters have no gyroscope */
    IMUFIELD_TOO_SHORT = -3,      /* the block is cut */
    IMUFIELD_NOT_A_BLOCK = -4,    /* wrong magic */
    IMUFIELD_NEWER = -5,          /* written by a newer version */
    IMUFIELD_DAMAGED = -6         /* wrong size or checksum */
};

typedef struct imufield_parameters {
    int has_gyroscope;
    int quadratic_on_body_axes;
    imufield_real scale[3];                /* K, raw unit per m/s^2 */
    imufield_real bias[3];                 /* b, m/s^2 */
    imufield_real inverse_alignment[3][3]; /* T^-1 */
    imufield_real quadratic[3];            /* K2, raw unit per (m/s^2)^2 */
    imufield_real raw_zero[3];             /* raw unit */
    imufield_real rate_matrix[3][3];       /* M, rad/s per raw unit */
    imufield_real rate_offset[3];          /* raw unit */
    imufield_real g_sensitivity[3][3];     /* G, raw unit per m/s^2 */
} imufield_parameters;

/* One triad over temperature, with d the temperature above `reference` in degC: raw - raw_zero is (1 + scale(d)) times what it is
 * at the reference, bias(d) added to that before. Row n - 1 is the factor of d^n. */
typedef struct imufield_temperature {
    imufield_real reference;               /* degC */
    imufield_real range[2];                /* degC */
    imufield_real bias[5][3];              /* raw unit per degC^n */
    imufield_real scale[5][3];             /* relative, per degC^n */
    imufield_real raw_zero[3];             /* raw unit */
} imufield_temperature;

/* Raw output of a triad at a temperature in degC to what it would be at the reference: then apply it as any other.
 * A temperature that is not a number counts as the reference. `raw` and `out` may be the same. */
static inline void imufield_at_reference(const imufield_temperature *t, imufield_real degc, const imufield_real raw[3],
                                         imufield_real out[3])
{
    imufield_real d;
    int i, n;
    if (degc != degc) {
        degc = t->reference;
    }
    degc = degc < t->range[0] ? t->range[0] : degc > t->range[1] ? t->range[1] : degc;
    d = degc - t->reference;
    for (i = 0; i < 3; i++) {
        imufield_real bias = 0, scale = 0;
        for (n = 4; n >= 0; n--) {
            bias = (bias + t->bias[n][i]) * d;
            scale = (scale + t->scale[n][i]) * d;
        }
        out[i] = (raw[i] - t->raw_zero[i]) / (1 + scale) + t->raw_zero[i] - bias;
    }
}

static inline void imufield_multiply(const imufield_real matrix[3][3], const imufield_real vector[3],
                                     imufield_real product[3])
{
    int i;
    for (i = 0; i < 3; i++) {
        product[i] = matrix[i][0] * vector[0] + matrix[i][1] * vector[1] + matrix[i][2] * vector[2];
    }
}

static inline imufield_real imufield_size(imufield_real value)
{
    return value < 0 ? -value : value;
}

/* Solve K s + K2 s^2 = output for the root that is output / K where K2 vanishes. */
static inline int imufield_solve_axis(imufield_real scale, imufield_real quadratic, imufield_real output, imufield_real *s)
{
    imufield_real step, last = 0;
    int pass;
    *s = output / scale;
    if (quadratic == 0) {
        return IMUFIELD_OK;
    }
    if (scale * scale + 4 * quadratic * output < 0) {
        return IMUFIELD_NO_SOLUTION;
    }
    /* Newton's steps: each doubles the number of right digits, and from rounding on they stop shrinking. */
    for (pass = 0; pass < 60; pass++) {
        const imufield_real slope = scale + 2 * quadratic * *s;
        if (slope == 0) {
            break;
        }
        step = ((scale + quadratic * *s) * *s - output) / slope;
        *s -= step;
        if (step == 0 || (pass > 3 && imufield_size(step) >= last)) {
            break;
        }
        last = imufield_size(step);
    }
    return IMUFIELD_OK;
}

/* Quadratic term on body axes: a = T^-1 ((output - K2 a^2) / K), a contraction. */
static inline int imufield_solve_body(const imufield_parameters *p, const imufield_real output[3], imufield_real force[3])
{
    const imufield_real enough = sizeof(imufield_real) < sizeof(double) ? (imufield_real)1e-6 : (imufield_real)1e-14;
    imufield_real s[3], next[3], change = 0, largest = 0;
    int pass, i;
    for (i = 0; i < 3; i++) {
        s[i] = output[i] / p->scale[i];
    }
    imufield_multiply(p->inverse_alignment, s, force);
    for (pass = 0; pass < 60; pass++) {
        change = largest = 0;
        for (i = 0; i < 3; i++) {
            s[i] = (output[i] - p->quadratic[i] * force[i] * force[i]) / p->scale[i];
        }
        imufield_multiply(p->inverse_alignment, s, next);
        for (i = 0; i < 3; i++) {
            const imufield_real difference = imufield_size(next[i] - force[i]);
            change = difference > change ? difference : change;
            largest = imufield_size(next[i]) > largest ? imufield_size(next[i]) : largest;
            force[i] = next[i];
        }
        if (!(change > enough * largest)) {
            return IMUFIELD_OK;
        }
    }
    return change > 100 * enough * largest ? IMUFIELD_NO_SOLUTION : IMUFIELD_OK;
}

/* Raw accelerometer output to specific force in m/s^2. On an error `force` is not changed. */
static inline int imufield_apply_accelerometer(const imufield_parameters *p, const imufield_real raw[3], imufield_real force[3])
{
    imufield_real output[3], s[3];
    int i;
    for (i = 0; i < 3; i++) {
        output[i] = raw[i] - p->raw_zero[i] - p->scale[i] * p->bias[i];
    }
    if (p->quadratic_on_body_axes) {
        const int status = imufield_solve_body(p, output, s);
        if (status == IMUFIELD_OK) {
            memcpy(force, s, sizeof s);
        }
        return status;
    }
    for (i = 0; i < 3; i++) {
        const int status = imufield_solve_axis(p->scale[i], p->quadratic[i], output[i], &s[i]);
        if (status != IMUFIELD_OK) {
            return status;
        }
    }
    imufield_multiply(p->inverse_alignment, s, force);
    return IMUFIELD_OK;
}

/* Raw gyroscope output and corrected specific force to angular rate in rad/s. On an error `rate` is not changed. */
static inline int imufield_apply_gyroscope(const imufield_parameters *p, const imufield_real raw[3],
                                           const imufield_real force[3], imufield_real rate[3])
{
    imufield_real output[3];
    int i;
    if (!p->has_gyroscope) {
        return IMUFIELD_NO_GYROSCOPE;
    }
    imufield_multiply(p->g_sensitivity, force, output);
    for (i = 0; i < 3; i++) {
        output[i] = raw[i] - p->rate_offset[i] - output[i];
    }
    imufield_multiply(p->rate_matrix, output, rate);
    return IMUFIELD_OK;
}

/* Both triads of one sample. */
static inline int imufield_apply(const imufield_parameters *p, const imufield_real raw_accelerometer[3],
                                 const imufield_real raw_gyroscope[3], imufield_real force[3], imufield_real rate[3])
{
    const int status = imufield_apply_accelerometer(p, raw_accelerometer, force);
    return status == IMUFIELD_OK ? imufield_apply_gyroscope(p, raw_gyroscope, force, rate) : status;
}

/* The binary block, all little-endian: "IMUFIELD", version u16, size u16, flags u32, accelerometer and gyroscope raw unit
 * (16 bytes each), serial number (32), time of calibration (24), 45 float64 from byte 104 (scale, bias, inverse_alignment,
 * quadratic, raw_zero, rate_matrix, rate_offset, g_sensitivity, gravity, lowest and highest temperature), reserved u32,
 * CRC-32 (as in zlib) of everything before it. */
#define IMUFIELD_BLOCK_VERSION 1u
#define IMUFIELD_BLOCK_SIZE 472u

static inline uint32_t imufield_u32(const unsigned char *at)
{
    return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

static inline const unsigned char *imufield_take(const unsigned char *at, imufield_real *values, int count)
{
    int i;
    for (i = 0; i < count; i++, at += 8) {
        const uint64_t bits = (uint64_t)imufield_u32(at) | (uint64_t)imufield_u32(at + 4) << 32;
        double value;
        memcpy(&value, &bits, sizeof value);
        values[i] = (imufield_real)value;
    }
    return at;
}

static inline uint32_t imufield_crc32(const unsigned char *data, size_t size)
{
    uint32_t crc = 0xFFFFFFFFu;
    int bit;
    while (size--) {
        crc ^= *data++;
        for (bit = 0; bit < 8; bit++) {
            crc = (crc & 1u) ? crc >> 1 ^ 0xEDB88320u : crc >> 1;
        }
    }
    return ~crc;
}

/* Read the block that imufield's binary export wrote. On an error `p` is not changed. */
static inline int imufield_read(const unsigned char *data, size_t size, imufield_parameters *p)
{
    imufield_parameters read;
    uint32_t flags;
    if (size < 12) {
        return IMUFIELD_TOO_SHORT;
    }
    if (memcmp(data, "IMUFIELD", 8) != 0) {
        return IMUFIELD_NOT_A_BLOCK;
    }
    if (((unsigned)data[8] | (unsigned)data[9] << 8) != IMUFIELD_BLOCK_VERSION) {
        return IMUFIELD_NEWER;
    }
    if (((unsigned)data[10] | (unsigned)data[11] << 8) != IMUFIELD_BLOCK_SIZE) {
        return IMUFIELD_DAMAGED;
    }
    if (size < IMUFIELD_BLOCK_SIZE) {
        return IMUFIELD_TOO_SHORT;
    }
    if (imufield_u32(data + IMUFIELD_BLOCK_SIZE - 4) != imufield_crc32(data, IMUFIELD_BLOCK_SIZE - 4)) {
        return IMUFIELD_DAMAGED;
    }
    flags = imufield_u32(data + 12);
    read.has_gyroscope = (int)(flags & 1u);
    read.quadratic_on_body_axes = (int)(flags >> 1 & 1u);
    data = imufield_take(data + 104, read.scale, 3);
    data = imufield_take(data, read.bias, 3);
    data = imufield_take(data, &read.inverse_alignment[0][0], 9);
    data = imufield_take(data, read.quadratic, 3);
    data = imufield_take(data, read.raw_zero, 3);
    data = imufield_take(data, &read.rate_matrix[0][0], 9);
    data = imufield_take(data, read.rate_offset, 3);
    imufield_take(data, &read.g_sensitivity[0][0], 9);
    *p = read;
    return IMUFIELD_OK;
}

#endif /* IMUFIELD_APPLY_H */
