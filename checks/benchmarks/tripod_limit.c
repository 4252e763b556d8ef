/* SPDX-License-Identifier: Apache-2.0 */
/* The limit for the tripod's kernel: the same equations, scheme and steps by hand, without effects.
 *
 * One candidate in each lane of an AVX-512 register; gcc -O3 -march=native. See kernel.py.
 */
#include <immintrin.h>
#include <stdint.h>
#include <string.h>

#define LANES 8
typedef double vec __attribute__((vector_size(64)));
typedef int64_t whole __attribute__((vector_size(64)));
#define INLINE static inline __attribute__((always_inline))

/* Rows of a candidate's block: four of the machine, then PER_DRIVE of each drive. */
enum { RADIUS, LENGTH, TOOL, GRAVITY, MACHINE };
enum { STIFFNESS, DAMPING, MOTOR, RAIL, COULOMB, VISCOUS, KP, KV, KI, LIMIT, DELAY, PER_DRIVE };
#define ROWS (MACHINE + 3 * PER_DRIVE)
#define FAST 8.0

INLINE vec spread(double x) { return (vec)_mm512_set1_pd(x); }
INLINE vec least(vec a, vec b) { return (vec)_mm512_min_pd((__m512d)a, (__m512d)b); }
INLINE vec most(vec a, vec b) { return (vec)_mm512_max_pd((__m512d)a, (__m512d)b); }
INLINE vec root(vec a) { return (vec)_mm512_sqrt_pd((__m512d)a); }
INLINE vec size(vec a) { return (vec)_mm512_abs_pd((__m512d)a); }
INLINE vec pick(__mmask8 m, vec a, vec b)
{
    return (vec)_mm512_mask_blend_pd(m, (__m512d)b, (__m512d)a);
}
INLINE __mmask8 below(vec a, vec b)
{
    return _mm512_cmp_pd_mask((__m512d)a, (__m512d)b, _CMP_LT_OQ);
}

INLINE vec tangent(vec x)
{
    __mmask8 near = below(size(x), spread(9.2));
    whole sign = (whole)x & (INT64_MIN - (whole){0});
    vec flat = (vec)(sign | (whole)spread(0.9999999795820788));
    if (!near)
        return flat;
    vec u = x * x * (1.0 / 84.64);
    vec p = 0.15476603502272979 * u + 5.612164909892022;
    vec q = 12.528558028118812 * u + 132.10893444678678;
    p = p * u + 25.43779612478148;
    q = q * u + 302.2215188334761;
    p = p * u + 31.6171925602088;
    q = q * u + 208.87906864537354;
    p = p * u + 11.92557785362088;
    q = q * u + 40.13891109171854;
    p = p * u + 0.9999999997639548;
    q = q * u + 1.0;
    return pick(near, x * p / q, flat);
}

typedef struct {
    vec z[3], v[3], s[3], w[3];       /* motors and carriages, their rates */
    vec az[4][3], as[4][3];           /* accelerations of the stages */
    vec drift[3];                     /* of the carriages, at the last step's end */
    vec i11, i22, i33, i12, i13, i23; /* inverse mass matrix */
    vec load[3];
    vec inverse_radius;
    vec integral[3], drive[3], before[3], cost[3];
    vec coulomb[3], viscous[3], lightness[3], at[3], part[3];
} State;

INLINE void linkage(const vec *par, State *q, const vec *s, const vec *w, const double *grid)
{
    vec r = par[RADIUS], mass = par[TOOL], g = par[GRAVITY], inverse = q->inverse_radius;
    vec u2 = s[1] - s[0], u3 = s[2] - s[0];
    vec bx = (grid[0] * u2 + grid[1] * u3) * inverse, by = (grid[2] * u2 + grid[3] * u3) * inverse;
    vec h2 = 0.5 * u2 * u2, h3 = 0.5 * u3 * u3;
    vec qx = (grid[0] * h2 + grid[1] * h3) * inverse - r * grid[4];
    vec qy = (grid[2] * h2 + grid[3] * h3) * inverse - r * grid[5];
    vec a = bx * bx + by * by + 1.0, b = bx * qx + by * qy;
    vec z1 = (root(b * b - a * (qx * qx + qy * qy - par[LENGTH] * par[LENGTH])) - b) / a;
    vec z2 = z1 + u2, z3 = z1 + u3;
    vec x1 = -(qx + bx * z1), y1 = -(qy + by * z1);
    vec x2 = x1 + r * (grid[6] - grid[4]), y2 = y1 + r * (grid[7] - grid[5]);
    vec x3 = x1 + r * (grid[8] - grid[4]), y3 = y1 + r * (grid[9] - grid[5]);
    vec cx1 = y2 * z3 - y3 * z2, cy1 = z2 * x3 - z3 * x2, cz1 = x2 * y3 - x3 * y2;
    vec cx2 = y3 * z1 - y1 * z3, cy2 = z3 * x1 - z1 * x3, cz2 = x3 * y1 - x1 * y3;
    vec cx3 = y1 * z2 - y2 * z1, cy3 = z1 * x2 - z2 * x1, cz3 = x1 * y2 - x2 * y1;
    vec over = 1.0 / (x1 * cx1 + y1 * cy1 + z1 * cz1);
    vec k1 = z1 * over, k2 = z2 * over, k3 = z3 * over;
    vec ax1 = cx1 * k1, ay1 = cy1 * k1, az1 = cz1 * k1;
    vec ax2 = cx2 * k2, ay2 = cy2 * k2, az2 = cz2 * k2;
    vec ax3 = cx3 * k3, ay3 = cy3 * k3, az3 = cz3 * k3;
    vec vx = ax1 * w[0] + ax2 * w[1] + ax3 * w[2];
    vec vy = ay1 * w[0] + ay2 * w[1] + ay3 * w[2];
    vec vz = az1 * w[0] + az2 * w[1] + az3 * w[2];
    vec square = vx * vx + vy * vy;
    vec d1 = w[0] - vz, d2 = w[1] - vz, d3 = w[2] - vz;
    vec c1 = (square + d1 * d1) * over, c2 = (square + d2 * d2) * over;
    vec c3 = (square + d3 * d3) * over;
    vec ex = cx1 * c1 + cx2 * c2 + cx3 * c3, ey = cy1 * c1 + cy2 * c2 + cy3 * c3;
    vec ez = cz1 * c1 + cz2 * c2 + cz3 * c3 + g;
    vec r1 = par[MACHINE + RAIL], r2 = par[MACHINE + PER_DRIVE + RAIL];
    vec r3 = par[MACHINE + 2 * PER_DRIVE + RAIL];
    q->load[0] = mass * (ax1 * ex + ay1 * ey + az1 * ez) + g * r1;
    q->load[1] = mass * (ax2 * ex + ay2 * ey + az2 * ez) + g * r2;
    q->load[2] = mass * (ax3 * ex + ay3 * ey + az3 * ez) + g * r3;
    vec mx1 = mass * ax1, my1 = mass * ay1, mz1 = mass * az1;
    vec mx2 = mass * ax2, my2 = mass * ay2, mz2 = mass * az2;
    vec m11 = mx1 * ax1 + my1 * ay1 + (mz1 * az1 + r1);
    vec m22 = mx2 * ax2 + my2 * ay2 + (mz2 * az2 + r2);
    vec m33 = mass * (ax3 * ax3 + ay3 * ay3 + az3 * az3) + r3;
    vec m12 = mx1 * ax2 + my1 * ay2 + mz1 * az2, m13 = mx1 * ax3 + my1 * ay3 + mz1 * az3;
    vec m23 = mx2 * ax3 + my2 * ay3 + mz2 * az3;
    vec n11 = m22 * m33 - m23 * m23, n12 = m13 * m23 - m12 * m33, n13 = m12 * m23 - m13 * m22;
    vec det = 1.0 / (m11 * n11 + m12 * n12 + m13 * n13);
    q->i11 = n11 * det;
    q->i22 = (m11 * m33 - m13 * m13) * det;
    q->i33 = (m11 * m22 - m12 * m12) * det;
    q->i12 = n12 * det;
    q->i13 = n13 * det;
    q->i23 = (m12 * m13 - m11 * m23) * det;
}

INLINE void step(const vec *par, State *q, vec h, double steepness)
{
    for (int k = 0; k < 4; k++) {
        vec near = h * (k == 0 ? 0.0 : k == 3 ? 1.0 : 0.5);
        vec square = h * h * (k < 2 ? 0.0 : k == 2 ? 0.25 : 0.5);
        int before = k ? k - 1 : 0, earlier = k > 1 ? k - 2 : 0;
        vec f[3];
        for (int d = 0; d < 3; d++) {
            const vec *p = par + MACHINE + d * PER_DRIVE;
            vec v = q->v[d] + near * q->az[before][d], w = q->w[d] + near * q->as[before][d];
            vec stretch = (q->z[d] - q->s[d]) + near * (q->v[d] - q->w[d])
                + square * (q->az[earlier][d] - q->as[earlier][d]);
            vec force = p[STIFFNESS] * stretch + p[DAMPING] * (v - w);
            q->az[k][d] = q->drive[d] - q->coulomb[d] * tangent(v * steepness)
                - q->viscous[d] * v - q->lightness[d] * force;
            f[d] = force - q->load[d];
        }
        q->as[k][0] = q->i11 * f[0] + q->i12 * f[1] + q->i13 * f[2];
        q->as[k][1] = q->i12 * f[0] + q->i22 * f[1] + q->i23 * f[2];
        q->as[k][2] = q->i13 * f[0] + q->i23 * f[1] + q->i33 * f[2];
    }
    vec sixth = h * (1.0 / 6.0);
    for (int d = 0; d < 3; d++) {
        vec a = q->az[1][d] + q->az[2][d], b = q->as[1][d] + q->as[2][d];
        q->z[d] += h * (q->v[d] + sixth * (q->az[0][d] + a));
        q->s[d] += h * (q->w[d] + sixth * (q->as[0][d] + b));
        q->v[d] += sixth * (q->az[0][d] + (a + a + q->az[3][d]));
        q->w[d] += sixth * (q->as[0][d] + (b + b + q->as[3][d]));
    }
}

/* Sum the squared errors (G, 3, 8) of blocks of candidates.
 *
 * blocks (G, ROWS, 8); steps (G, 2, 8) while fast and otherwise; command (6, K) positions, then
 * rates; measured (3, K + 1), NaN where there is no sample and at the end; grid (10,).
 */
void simulate(int64_t groups, const double *blocks, const double *steps, const double *command,
              int64_t count, const double *measured, const double *grid, double gear, double eps,
              double cycle, double feedforward, double *cost)
{
    const vec zero = spread(0.0);
    for (int64_t g = 0; g < groups; g++) {
        const vec *par = (const vec *)blocks + g * ROWS;
        const vec fast_steps = ((const vec *)steps)[2 * g], slow_steps = ((const vec *)steps)[2 * g + 1];
        State q;
        memset(&q, 0, sizeof q);
        q.inverse_radius = 1.0 / par[RADIUS];
        for (int d = 0; d < 3; d++)
            q.s[d] = spread(command[d * count]);
        linkage(par, &q, q.s, q.w, grid);
        for (int d = 0; d < 3; d++) {
            const vec *p = par + MACHINE + d * PER_DRIVE;
            q.z[d] = q.s[d] + q.load[d] / p[STIFFNESS];
            q.integral[d] = q.load[d] * (1.0 / gear);
            q.lightness[d] = 1.0 / p[MOTOR];
            q.coulomb[d] = gear * q.lightness[d] * p[COULOMB];
            q.viscous[d] = gear * q.lightness[d] * p[VISCOUS];
            vec delay = p[DELAY] / cycle;
            q.at[d] = (vec)_mm512_floor_pd((__m512d)delay);
            q.part[d] = delay - q.at[d];
        }
        for (int64_t k = 0; k < count; k++) {
            __mmask8 fast = 0xff;
            for (int d = 0; d < 3; d++) {
                const vec *p = par + MACHINE + d * PER_DRIVE;
                vec error = p[KP] * (command[d * count + k] - q.z[d])
                    + (feedforward * command[(3 + d) * count + k] - q.v[d]);
                q.integral[d] += p[KI] * cycle * error;
                vec torque = least(most(p[KV] * error + q.integral[d], -p[LIMIT]), p[LIMIT]);
                q.drive[d] = gear * q.lightness[d] * torque;
                fast &= below(spread(FAST * eps), size(q.v[d]));
                if (k == 0) {
                    q.before[d] = torque;
                    for (int lane = 0; lane < LANES; lane++)
                        for (int64_t j = 0; j < (int64_t)q.at[d][lane] && j < count; j++) {
                            double e = measured[d * (count + 1) + j] - torque[lane];
                            q.cost[d][lane] += e == e ? e * e : 0.0;
                        }
                }
                vec late = torque + q.part[d] * (q.before[d] - torque);
                whole at = (whole)_mm512_cvtpd_epi64((__m512d)least(q.at[d], spread((double)count)));
                vec sample = (vec)_mm512_i64gather_pd((__m512i)at, measured + d * (count + 1), 8);
                vec e = sample - late;
                __mmask8 there = _mm512_cmp_pd_mask((__m512d)sample, (__m512d)sample, _CMP_ORD_Q);
                q.cost[d] = pick(there, q.cost[d] + e * e, q.cost[d]);
                q.at[d] += 1.0;
                q.before[d] = torque;
            }
            double half = 0.5 * cycle;
            vec s[3], w[3];
            for (int d = 0; d < 3; d++) {
                s[d] = q.s[d] + half * q.w[d];
                w[d] = q.w[d] + half * q.drift[d];
            }
            linkage(par, &q, s, w, grid);
            vec number = pick(fast, fast_steps, slow_steps), length = cycle / number;
            __mmask8 active = 0xff;
            for (double sub = 1.0; active; sub += 1.0) {
                step(par, &q, pick(active, length, zero), 1.0 / eps);
                for (int d = 0; d < 3; d++)
                    q.drift[d] = pick(active, q.as[3][d], q.drift[d]);
                active = below(spread(sub), number);
            }
        }
        for (int d = 0; d < 3; d++)
            ((vec *)cost)[g * 3 + d] = q.cost[d];
    }
}

/* Peak: `rounds` times twelve independent chains of fused multiply-adds, 2 * 8 * 12 operations. */
double peak(int64_t rounds)
{
    const vec a = spread(0.999999), b = spread(1e-9);
    vec x0 = a, x1 = a, x2 = a, x3 = a, x4 = a, x5 = a, x6 = a, x7 = a, x8 = a, x9 = a, xa = a, xb = a;
#define MORE(x) __asm__ volatile("vfmadd213pd %2, %1, %0" : "+v"(x) : "v"(a), "v"(b))
    for (int64_t r = 0; r < rounds; r++) {
        MORE(x0); MORE(x1); MORE(x2); MORE(x3); MORE(x4); MORE(x5);
        MORE(x6); MORE(x7); MORE(x8); MORE(x9); MORE(xa); MORE(xb);
    }
    vec sum = x0 + x1 + x2 + x3 + x4 + x5 + x6 + x7 + x8 + x9 + xa + xb;
    return sum[0];
}
