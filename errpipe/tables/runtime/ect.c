/* See ect.h. Section numbers in comments are those of ect-2.md, from which this file was written. */
#include "ect.h"

#include <string.h>

#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif

#define R(x) ((ect_real)(x))
#define BIG R(1e30)
#define HEADER 512u

enum { INPUTS, SUBSTITUTES, NODES, OPERANDS, LOOKUPS, PROFILES, VALUES, COMPONENTS, PAIRS, OUTPUTS, TERMS, SECTIONS };
enum { CONSTANT = 1, INPUT, AFFINE, FIRST, LAG, PRODUCT, POWER, CLIP, SWITCH, DIRECTION, APPROACH, LOOKUP };
enum { OPTIONAL = 1, FADE_ON_DEFAULT = 2, HAS_VALID = 4, HAS_MAX_RATE = 8, HAS_STALE = 16, HAS_HOLD = 32 };
enum { SLOW = 1, START_ZERO = 2 };
enum { HAS_MAGNITUDE = 1, HAS_SLEW = 2, HAS_ACCELERATION = 4 };
enum { SLOW_KINDS = 4, RECORD_INPUT_1 = 152 }; /* the record of an input in version 1 */
#define LOST 0x80000000u /* internal: an input that matters is down to its default */

static const uint32_t RECORD[SECTIONS] = {160, 16, 56, 16, 8, 72, 4, 24, 16, 88, 32};
static const uint32_t MOST[SECTIONS] = {64, 4096, 1024, 4096, 65536, 512, 4194304, 64, 2048, 64, 4096};
static const uint32_t FEWEST[SECTIONS] = {0, 0, 1, 0, 0, 1, 1, 1, 1, 1, 1};

/* bytes ------------------------------------------------------------------------------------------ */

static uint32_t u16_at(const uint8_t *p) { return (uint32_t)p[0] | (uint32_t)p[1] << 8; }

static uint32_t u32_at(const uint8_t *p)
{
    return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

static int32_t i32_at(const uint8_t *p)
{
    uint32_t u = u32_at(p);
    int32_t v;
    memcpy(&v, &u, sizeof v);
    return v;
}

#ifdef ECT_SINGLE
/* binary64 to binary32, to nearest even, by integers; what is too small becomes 0, too large 3e38, not a number 0/0 */
static ect_real real_at(const uint8_t *p)
{
    uint32_t low = u32_at(p), high = u32_at(p + 4), sign = high & 0x80000000u, bits, rest;
    int32_t exponent = (int32_t)(high >> 20 & 0x7FFu) - 1023;
    ect_real value;
    if (exponent == 1024) {
        bits = 0x7FC00000u;
    } else if (exponent < -126) {
        bits = sign;
    } else if (exponent > 127) {
        bits = sign | 0x7F7FFFFFu;
    } else {
        bits = (uint32_t)(exponent + 127) << 23 | (high & 0xFFFFFu) << 3 | low >> 29;
        rest = low & 0x1FFFFFFFu;
        if (rest > 0x10000000u || (rest == 0x10000000u && (bits & 1u))) {
            bits += 1;
        }
        bits |= sign;
    }
    memcpy(&value, &bits, sizeof value);
    return value;
}
#else
static ect_real real_at(const uint8_t *p)
{
    uint64_t bits = (uint64_t)u32_at(p) | (uint64_t)u32_at(p + 4) << 32;
    ect_real value;
    memcpy(&value, &bits, sizeof value);
    return value;
}
#endif

static int is_zero_bits(const uint8_t *p, uint32_t count)
{
    uint32_t i;
    for (i = 0; i < count; i++) {
        if (p[i] != 0) {
            return 0;
        }
    }
    return 1;
}

static int same_bytes(const uint8_t *a, const uint8_t *b, uint32_t count)
{
    uint32_t i;
    for (i = 0; i < count; i++) {
        if (a[i] != b[i]) {
            return 0;
        }
    }
    return 1;
}

static uint32_t crc_of(const uint8_t *p, size_t size)
{
    static const uint32_t nibble[16] = {
        0x00000000, 0x1DB71064, 0x3B6E20C8, 0x26D930AC, 0x76DC4190, 0x6B6B51F4, 0x4DB26158, 0x5005713C,
        0xEDB88320, 0xF00F9344, 0xD6D6A3E8, 0xCB61B38C, 0x9B64C2B0, 0x86D3D2D4, 0xA00AE278, 0xBDBDF21C};
    uint32_t crc = 0xFFFFFFFFu;
    size_t i;
    for (i = 0; i < size; i++) {
        crc ^= p[i];
        crc = crc >> 4 ^ nibble[crc & 15u];
        crc = crc >> 4 ^ nibble[crc & 15u];
    }
    return crc ^ 0xFFFFFFFFu;
}

/* What the signs of a text may be: all but control characters, those of a name, letters and digits. */
#define SIGNS_TEXT 0
#define SIGNS_NAME 1
#define SIGNS_AXIS 2

static int is_sign(uint8_t c, int signs)
{
    if ((c >= '0' && c <= '9') || (c >= 'A' && c <= 'Z') || (c >= 'a' && c <= 'z')) {
        return 1;
    }
    if (signs == SIGNS_AXIS || c < ' ' || c == 127) {
        return 0;
    }
    return signs == SIGNS_TEXT || c >= 0x80 || c == ' ' || c == '%' || c == '(' || c == ')' || c == '+'
        || (c >= '-' && c <= '/') || c == ':' || c == '[' || (c >= ']' && c <= '_');
}

/* Text field: UTF-8 of certain signs, then zero bytes, at least one. */
static int is_text(const uint8_t *p, uint32_t size, int may_be_empty, int signs)
{
    uint32_t i = 0, more, k;
    while (i < size && p[i] != 0) {
        uint8_t c = p[i], least = 0x80, most = 0xBF;
        if (!is_sign(c, signs)) {
            return 0;
        }
        if (c < 0x80) {
            more = 0;
        } else if (c >= 0xC2 && c <= 0xDF) {
            more = 1;
        } else if (c >= 0xE0 && c <= 0xEF) {
            more = 2;
            least = c == 0xE0 ? 0xA0 : 0x80;
            most = c == 0xED ? 0x9F : 0xBF;
        } else if (c >= 0xF0 && c <= 0xF4) {
            more = 3;
            least = c == 0xF0 ? 0x90 : 0x80;
            most = c == 0xF4 ? 0x8F : 0xBF;
        } else {
            return 0;
        }
        if (more >= size - i) {
            return 0;
        }
        for (k = 1; k <= more; k++) {
            if (p[i + k] < least || p[i + k] > most) {
                return 0;
            }
            least = 0x80;
            most = 0xBF;
        }
        i += more + 1;
    }
    return i < size && (i > 0 || may_be_empty) && is_zero_bits(p + i, size - i);
}

static int is_unique(const uint8_t *records, uint32_t record, uint32_t number, uint32_t size)
{
    uint32_t i;
    for (i = 0; i < number; i++) {
        if (same_bytes(records + i * record, records + number * record, size)) {
            return 0;
        }
    }
    return 1;
}

static int is_sane(ect_real x) { return x >= -BIG && x <= BIG; }
static int is_number(ect_real x) { return x >= R(-1e15) && x <= R(1e15); }

#ifdef ECT_SINGLE
#define SMALLEST R(0.99e-15)
#else
#define SMALLEST R(1e-15)
#endif
static int is_positive(ect_real x) { return x > SMALLEST && x <= R(1e15); }

/* A stored number that a formula of others gives. In binary64: every bit of it, so that 0 is not -0. In binary32, which
 * cannot know them, within 1e-5 of the formula; the sign is read from the file, as a tiny number rounds to 0. */
#ifdef ECT_SINGLE
static int is_within(const uint8_t *p, ect_real most) { return p[7] < 0x80 && real_at(p) <= most; }
static int is_near(ect_real a, ect_real b) { return a - b <= R(1e-5) && b - a <= R(1e-5); }
#else
static int is_stored(const uint8_t *p, ect_real x)
{
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return u32_at(p) == (uint32_t)(bits & 0xFFFFFFFFu) && u32_at(p + 4) == (uint32_t)(bits >> 32);
}
#endif

/* A parameter that stands only where its flag is set, else 8 zero bytes. */
static int is_optional(const uint8_t *p, int has)
{
    return has ? is_positive(real_at(p)) : is_zero_bits(p, 8);
}

/* arithmetic (9) --------------------------------------------------------------------------------- */

#ifdef ECT_SINGLE
#define LN2_HIGH R(0.693359375)
#define LN2_LOW R(-2.12194440e-4)
#define EXP_LIMIT R(80)
static const ect_real EXP_TERMS[8] = {
    R(0.0001984126984126984), R(0.001388888888888889), R(0.008333333333333333), R(0.041666666666666664),
    R(0.16666666666666666), R(0.5), R(1), R(1)};
static const ect_real LN_TERMS[5] = {
    R(0.1111111111111111), R(0.14285714285714285), R(0.2), R(0.3333333333333333), R(1)};
static const ect_real TWO_TO[7] = {R(18446744073709551616.0), R(4294967296.0), R(65536), R(256), R(16), R(4), R(2)};
enum { EXP_COUNT = 8, LN_COUNT = 5, STEPS = 7, LARGEST_STEP = 64 };
#else
#define LN2_HIGH 0.6931471803691238
#define LN2_LOW 1.9082149292705877e-10
#define EXP_LIMIT 700.0
static const ect_real EXP_TERMS[14] = {
    1.6059043836821613e-10, 2.08767569878681e-09, 2.505210838544172e-08, 2.755731922398589e-07,
    2.7557319223985893e-06, 2.48015873015873e-05, 0.0001984126984126984, 0.001388888888888889,
    0.008333333333333333, 0.041666666666666664, 0.16666666666666666, 0.5, 1.0, 1.0};
static const ect_real LN_TERMS[11] = {
    0.047619047619047616, 0.05263157894736842, 0.058823529411764705, 0.06666666666666667, 0.07692307692307693,
    0.09090909090909091, 0.1111111111111111, 0.14285714285714285, 0.2, 0.3333333333333333, 1.0};
static const ect_real TWO_TO[10] = {
    1.3407807929942597e154, 1.157920892373162e77, 3.402823669209385e38, 18446744073709551616.0, 4294967296.0,
    65536.0, 256.0, 16.0, 4.0, 2.0};
enum { EXP_COUNT = 14, LN_COUNT = 11, STEPS = 10, LARGEST_STEP = 512 };
#endif

static ect_real exp_of(ect_real y)
{
    ect_real r, p, w;
    int32_t n, m, i;
    if (y < -EXP_LIMIT) {
        return R(0);
    }
    if (y > EXP_LIMIT) {
        y = EXP_LIMIT;
    }
    n = (int32_t)(y >= R(0) ? y * R(1.4426950408889634) + R(0.5) : y * R(1.4426950408889634) - R(0.5));
    r = (y - (ect_real)n * LN2_HIGH) - (ect_real)n * LN2_LOW;
    p = EXP_TERMS[0];
    for (i = 1; i < EXP_COUNT; i++) {
        p = p * r + EXP_TERMS[i];
    }
    w = n >= 0 ? R(2) : R(0.5);
    for (m = n >= 0 ? n : -n; m > 0; m /= 2) {
        if (m % 2 == 1) {
            p = p * w;
        }
        w = w * w;
    }
    return p;
}

static ect_real ln_of(ect_real x)
{
    ect_real s, z, p;
    int32_t k = 0, e, i;
    for (i = 0, e = LARGEST_STEP; i < STEPS; i++, e /= 2) {
        if (x >= TWO_TO[i]) {
            x = x / TWO_TO[i];
            k += e;
        }
    }
    if (x < R(1)) {
        for (i = 0, e = LARGEST_STEP; i < STEPS; i++, e /= 2) {
            if (x * TWO_TO[i] < R(2)) {
                x = x * TWO_TO[i];
                k -= e;
            }
        }
    }
    if (x > R(1.4142135623730951)) {
        x = x * R(0.5);
        k += 1;
    }
    s = (x - R(1)) / (x + R(1));
    z = s * s;
    p = LN_TERMS[0];
    for (i = 1; i < LN_COUNT; i++) {
        p = p * z + LN_TERMS[i];
    }
    return (ect_real)k * LN2_HIGH + (R(2) * s * p + (ect_real)k * LN2_LOW);
}

static int is_equal(ect_real a, ect_real b) { return a >= b && a <= b; }

static ect_real power_of(ect_real u, ect_real exponent)
{
    ect_real x = u < R(0) ? -u : u, p;
    if (x < R(1e-30)) {
        return R(0);
    }
    if (is_equal(exponent, R(1))) {
        p = x;
    } else if (is_equal(exponent, R(2))) {
        p = x * x;
    } else if (is_equal(exponent, R(3))) {
        p = x * x * x;
    } else {
        p = exp_of(exponent * ln_of(x));
    }
    return u < R(0) ? -p : p;
}

int ect_arithmetic_is_exact(void)
{
    volatile ect_real one = R(1), half = R(0.5), tiny = one, x, y, square, rest;
    int i;
#ifdef ECT_SINGLE
    const int bits = 12;
#else
    const int bits = 27;
#endif
    for (i = 0; i < bits; i++) {
        tiny = tiny * half;
    }
    x = one + tiny; /* x * x rounds to 1 + 2 * tiny: nothing is left unless the product was not rounded */
    {
        ect_real a = x, b = x, c;
        square = one + (tiny + tiny);
        y = square;
        c = y;
        rest = a * b - c;
    }
    return is_equal(rest, R(0));
}

/* loading (2, 3) --------------------------------------------------------------------------------- */

typedef struct {
    const uint8_t *at[SECTIONS];
    uint32_t count[SECTIONS];
    uint32_t rules, input_size;
} sections;

static ect_error find_sections(const uint8_t *t, size_t size, sections *s, uint32_t *where)
{
    static const uint8_t magic[8] = {0x45, 0x43, 0x54, 0x00, 0x0D, 0x0A, 0x1A, 0x0A};
    uint32_t i, at = HEADER;
    *where = 0;
    if (size < 8 || !same_bytes(t, magic, 4)) {
        return ECT_NOT_A_TABLE;
    }
    if (!same_bytes(t, magic, 8)) {
        return ECT_TEXT_MODE;
    }
    if (size < HEADER) {
        return ECT_CUT_OFF;
    }
    s->rules = u32_at(t + 8);
    s->input_size = s->rules == 1 ? (uint32_t)RECORD_INPUT_1 : RECORD[INPUTS];
    if (s->rules < 1 || s->rules > 2 || u32_at(t + 12) != HEADER) {
        return ECT_VERSION;
    }
    if (u32_at(t + 16) != size) {
        return ECT_CUT_OFF;
    }
    for (i = 0; i < SECTIONS; i++) {
        const uint8_t *row = t + 320 + 16 * i;
        uint32_t count = u32_at(row + 8), size_of_one = i == INPUTS ? s->input_size : RECORD[i], bytes;
        *where = i + 1;
        if (u32_at(row) != i + 1 || u32_at(row + 4) != size_of_one || count > MOST[i] || count < FEWEST[i]) {
            return ECT_SECTION;
        }
        bytes = count * size_of_one; /* at most 16 MiB: no overflow */
        if (u32_at(row + 12) != at || bytes > size - at) {
            return ECT_SECTION;
        }
        s->at[i] = t + at;
        s->count[i] = count;
        bytes = (bytes + 7u) & ~7u;
        if (bytes > size - at) {
            return ECT_SECTION;
        }
        at += bytes;
        if (!is_zero_bits(s->at[i] + count * size_of_one, bytes - count * size_of_one)) {
            return ECT_SECTION;
        }
    }
    return at == size ? ECT_OK : ECT_SECTION;
}

static size_t round_up(size_t bytes) { return (bytes + 7u) & ~(size_t)7u; }

static size_t place(void **what, uint8_t *work, size_t at, uint32_t count, size_t each)
{
    if (work != NULL) {
        *what = work + at;
    }
    return at + round_up(count * each);
}

/* Places of all arrays in the work area; returns its size. work may be NULL. */
static size_t lay_out(ect *e, const sections *s, uint8_t *work)
{
    size_t at = 0;
    void *p = NULL;
    at = place(&p, work, at, s->count[INPUTS], sizeof(ect_input));
    e->inputs = p;
    at = place(&p, work, at, s->count[SUBSTITUTES], sizeof(ect_weighted));
    e->substitutes = p;
    at = place(&p, work, at, s->count[NODES], sizeof(ect_node));
    e->nodes = p;
    at = place(&p, work, at, s->count[OPERANDS], sizeof(ect_weighted));
    e->operands = p;
    at = place(&p, work, at, s->count[LOOKUPS], sizeof(ect_real));
    e->lookups = p;
    at = place(&p, work, at, s->count[PROFILES], sizeof(ect_profile));
    e->profiles = p;
    at = place(&p, work, at, s->count[COMPONENTS], sizeof(ect_real));
    e->components = p;
    at = place(&p, work, at, s->count[PAIRS], sizeof(ect_pair));
    e->pairs = p;
    at = place(&p, work, at, s->count[OUTPUTS], sizeof(ect_output));
    e->outputs = p;
    at = place(&p, work, at, s->count[TERMS], sizeof(ect_term));
    e->terms = p;
    at = place(&p, work, at, s->count[NODES], sizeof(uint32_t));
    e->fast = p;
    return at;
}

size_t ect_work_size(const void *table, size_t size)
{
    sections s;
    ect e;
    uint32_t where;
    if (table == NULL || find_sections(table, size, &s, &where) != ECT_OK) {
        return 0;
    }
    return lay_out(&e, &s, NULL);
}

static ect_error load_header(ect *e, const uint8_t *t)
{
    e->slow_every = u32_at(t + 24);
    e->cycle = real_at(t + 32);
    e->thermal = real_at(t + 40);
    e->ramp_time = real_at(t + 48);
    e->fade_time = real_at(t + 56);
    if (e->slow_every < 1 || e->slow_every > 1000000 || u32_at(t + 28) != 0) {
        return ECT_HEADER;
    }
    if (!(e->cycle >= R(1e-6) && e->cycle <= R(10))) {
        return ECT_HEADER;
    }
#ifndef ECT_SINGLE
    if (!is_stored(t + 40, e->cycle * (ect_real)e->slow_every)) {
        return ECT_HEADER;
    }
#else
    if (!is_near(e->thermal / (e->cycle * (ect_real)e->slow_every), R(1))) {
        return ECT_HEADER;
    }
#endif
    if (!(e->ramp_time >= R(0) && e->ramp_time <= R(3600) && e->fade_time >= R(0) && e->fade_time <= R(3600))) {
        return ECT_HEADER;
    }
    if (!is_text(t + 64, 64, 1, SIGNS_TEXT) || !is_text(t + 128, 128, 1, SIGNS_TEXT)
        || !is_text(t + 256, 32, 1, SIGNS_TEXT) || !is_zero_bits(t + 496, 16)) {
        return ECT_HEADER;
    }
    return ECT_OK;
}

static ect_error load_inputs(ect *e, const sections *s)
{
    uint32_t i, k, used = 0;
    for (i = 0; i < s->count[INPUTS]; i++) {
        const uint8_t *r = s->at[INPUTS] + i * s->input_size;
        ect_input *in = &e->inputs[i];
        e->where = i;
        in->flags = (uint16_t)u16_at(r + 58);
        in->first = u32_at(r + 60);
        in->count = u32_at(r + 64);
        in->low = real_at(r + 72);
        in->high = real_at(r + 80);
        in->max_rate = real_at(r + 88);
        in->stale_after = real_at(r + 96);
        in->hold = real_at(r + 104);
        in->fallback = real_at(r + 112);
        in->offset = real_at(r + 120);
        in->valid_low = real_at(r + 128);
        in->valid_high = real_at(r + 136);
        in->margin = real_at(r + 144);
        in->slow = s->rules > 1 && u16_at(r + 56) >= SLOW_KINDS;
        in->noise = s->rules > 1 ? real_at(r + 152) : R(0);
        if (!is_text(r, 32, 0, SIGNS_NAME) || !is_unique(s->at[INPUTS], s->input_size, i, 32)
            || !is_text(r + 32, 8, 1, SIGNS_AXIS) || !is_text(r + 40, 16, 1, SIGNS_NAME) || u16_at(r + 56) > 9
            || in->flags > 63 || u32_at(r + 68) != 0) {
            return ECT_INPUT;
        }
        if (!is_number(in->low) || !is_number(in->high) || !(in->low < in->high) || !(in->fallback >= in->low)
            || !(in->fallback <= in->high) || !is_number(in->offset)) {
            return ECT_INPUT;
        }
        if (!is_optional(r + 88, in->flags & HAS_MAX_RATE) || !is_optional(r + 96, in->flags & HAS_STALE)
            || !is_optional(r + 144, in->flags & HAS_VALID)) {
            return ECT_INPUT;
        }
        if (s->rules > 1 && (in->flags & HAS_MAX_RATE ? !(in->noise >= R(0) && in->noise <= R(1e15))
                                                      : !is_zero_bits(r + 152, 8))) {
            return ECT_INPUT;
        }
        if (in->flags & HAS_HOLD ? !(in->hold >= R(0) && in->hold <= R(1e15)) : !is_zero_bits(r + 104, 8)) {
            return ECT_INPUT;
        }
        if (in->flags & HAS_VALID ? !is_number(in->valid_low) || !is_number(in->valid_high)
                                        || !(in->valid_low <= in->valid_high)
                                  : !is_zero_bits(r + 128, 16)) {
            return ECT_INPUT;
        }
        if (in->first != used || in->count > s->count[SUBSTITUTES] - used) {
            return ECT_INPUT;
        }
        used += in->count;
    }
    e->where = used;
    if (used != s->count[SUBSTITUTES]) {
        return ECT_SUBSTITUTE;
    }
    e->quick = s->count[INPUTS];
    for (i = s->count[INPUTS]; i-- > 0;) {
        if (!e->inputs[i].slow) {
            e->inputs[i].next = (uint8_t)e->quick;
            e->quick = i;
        }
    }
    for (i = 0; i < s->count[INPUTS]; i++) {
        for (k = e->inputs[i].first; k < e->inputs[i].first + e->inputs[i].count; k++) {
            const uint8_t *r = s->at[SUBSTITUTES] + k * RECORD[SUBSTITUTES];
            uint32_t number = u32_at(r);
            e->where = k;
            e->substitutes[k].number = number;
            e->substitutes[k].weight = real_at(r + 8);
            if (number >= s->count[INPUTS] || number == i || (e->inputs[number].flags & OPTIONAL) || u32_at(r + 4) != 0
                || !is_number(e->substitutes[k].weight)) {
                return ECT_SUBSTITUTE;
            }
        }
    }
    return ECT_OK;
}

static int is_node_sound(const ect *e, const ect_node *n, const uint8_t *r, const sections *s)
{
    static const uint32_t fewest[13] = {0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 2, 1};
    static const uint32_t most[13] = {0, 0, 0, 64, 1, 1, 16, 1, 1, 1, 2, 2, 1};
    static const uint32_t zero_from[13] = {0, 32, 24, 32, 24, 56, 24, 32, 40, 40, 40, 40, 48};
    uint32_t zero;
    ect_real dt = n->flags & SLOW ? e->cycle * (ect_real)e->slow_every : e->cycle;
    if (n->op < CONSTANT || n->op > LOOKUP || n->count < fewest[n->op] || n->count > most[n->op]) {
        return 0;
    }
    if (u16_at(r + 2) > 3 || ((n->flags & START_ZERO) && n->op != LAG) || u32_at(r + 20) != 0) {
        return 0;
    }
    zero = n->op == APPROACH && s->rules == 1 ? 32u : zero_from[n->op];
    if (!is_zero_bits(r + zero, 56 - zero)) {
        return 0;
    }
    if ((n->op != INPUT && n->op != LOOKUP && n->other != 0) || (n->op != LOOKUP && n->others != 0)) {
        return 0;
    }
    switch (n->op) {
    case INPUT:
        return n->other < s->count[INPUTS];
    case CONSTANT:
    case AFFINE:
        return is_number(n->a);
    case LAG:
        if (!is_positive(n->a) || !is_positive(n->b)) {
            return 0;
        }
#ifdef ECT_SINGLE
        return is_within(r + 40, R(1)) && is_within(r + 48, R(1)) && is_near(n->c, exp_of(-(dt / n->a)))
            && is_near(n->d, exp_of(-(dt / n->b)));
#else
        return is_stored(r + 40, exp_of(-(dt / n->a))) && is_stored(r + 48, exp_of(-(dt / n->b)));
#endif
    case POWER:
        return n->a > R(0) && n->a <= R(16);
    case CLIP:
        return is_number(n->a) && is_number(n->b) && n->a <= n->b;
    case SWITCH:
        return is_number(n->a) && is_number(n->b) && n->b <= n->a;
    case DIRECTION:
        return n->a >= R(0) && n->a <= R(1e15) && (is_equal(n->b, R(1)) || is_equal(n->b, R(-1)));
    case APPROACH:
        return is_positive(n->a) && n->b >= R(0) && n->b <= R(1e15);
    case LOOKUP:
        if (!is_number(n->a) || !is_positive(n->b) || n->others < 2) {
            return 0;
        }
#ifdef ECT_SINGLE
        return is_within(r + 40, R(1.1e15)) && is_near(n->c * n->b, R(1));
#else
        return is_stored(r + 40, R(1) / n->b);
#endif
    default:
        return 1;
    }
}

/* The first cycle of a run is slow and evaluates every node: a constant needs no other. */
static void list_fast(ect *e, uint32_t count)
{
    uint32_t i;
    e->fast_count = 0;
    for (i = 0; i < count; i++) {
        if (e->nodes[i].op == INPUT && !(e->nodes[i].flags & SLOW)) {
            e->fast[e->fast_count++] = i;
        }
    }
    e->fast_inputs = e->fast_count;
    for (i = 0; i < count; i++) {
        if (e->nodes[i].op > INPUT && !(e->nodes[i].flags & SLOW)) {
            e->fast[e->fast_count++] = i;
        }
    }
}

#ifdef ECT_SINGLE
/* What is left of the way after x time constants, 1 - (1 - e^-x), of a slow lag as minus the share that is gone: what is
   left is 1 in single precision after 1e-8 of them, and the lag would stand still. */
static ect_real slow(ect_real left, ect_real x)
{
    return x < R(0.0625) ? -x * (R(1) - x * R(0.5) * (R(1) - x / R(3) * (R(1) - x * R(0.25)))) : left;
}

/* A cycle of a slow lag. What rounding leaves out is carried on, or it would stop short of its operand. */
static ect_real creep(ect_node *n, ect_real goal, ect_real share)
{
    ect_real y = n->value, step = n->kept_value + (goal - y - n->kept_value) * share, next = y + step;
    n->kept_value = step - (next - y);
    return next;
}
#endif

static ect_error load_nodes(ect *e, const sections *s)
{
    uint32_t i, k, used = 0, values = 0;
    for (i = 0; i < s->count[NODES]; i++) {
        const uint8_t *r = s->at[NODES] + i * RECORD[NODES];
        ect_node *n = &e->nodes[i];
        e->where = i;
        n->op = (uint16_t)u16_at(r);
        n->flags = (uint8_t)(u16_at(r + 2) & 3u);
        n->first = u32_at(r + 4);
        n->count = u32_at(r + 8);
        n->other = u32_at(r + 12);
        n->others = u32_at(r + 16);
        n->a = real_at(r + 24);
        n->b = real_at(r + 32);
        n->c = real_at(r + 40);
        n->d = real_at(r + 48);
        if (!is_node_sound(e, n, r, s) || n->first != used || n->count > s->count[OPERANDS] - used) {
            return ECT_NODE;
        }
        for (k = used; k < used + n->count; k++) {
            const uint8_t *o = s->at[OPERANDS] + k * RECORD[OPERANDS];
            e->operands[k].number = u32_at(o);
            e->operands[k].weight = real_at(o + 8);
            if (e->operands[k].number >= i || u32_at(o + 4) != 0 || !is_number(e->operands[k].weight)
                || (n->op != AFFINE && !is_equal(e->operands[k].weight, R(1)))) {
                e->where = k;
                return ECT_OPERAND;
            }
        }
        used += n->count;
#ifdef ECT_SINGLE
        if (n->op == LAG) {
            ect_real dt = n->flags & SLOW ? e->thermal : e->cycle;
            n->c = slow(n->c, dt / n->a);
            n->d = slow(n->d, dt / n->b);
        }
#endif
        if (n->op == LOOKUP) {
            if (n->other != values || n->others > s->count[LOOKUPS] - values) {
                return ECT_NODE;
            }
            values += n->others;
        }
    }
    e->where = used;
    if (used != s->count[OPERANDS]) {
        return ECT_OPERAND;
    }
    list_fast(e, s->count[NODES]);
    for (i = 0; i < s->count[LOOKUPS]; i++) {
        e->where = i;
        e->lookups[i] = real_at(s->at[LOOKUPS] + i * RECORD[LOOKUPS]);
        if (!is_number(e->lookups[i])) {
            return ECT_LOOKUP;
        }
    }
    e->where = values;
    return values == s->count[LOOKUPS] ? ECT_OK : ECT_LOOKUP;
}

static int is_error_bound(const uint8_t *p)
{
    uint32_t high = u32_at(p + 4); /* finite and not negative, or -0 */
    return (high & 0x7FF00000u) != 0x7FF00000u && (high < 0x80000000u || (high == 0x80000000u && u32_at(p) == 0));
}

static int is_turn_count_small(const ect_input *in, const ect_profile *p, ect_real step)
{
    ect_real period = (ect_real)p->last * step;
    const ect_real ends[4] = {in->low, in->high, in->valid_low, in->valid_high}; /* the table sees it within validity */
    int i;
    for (i = 0; i < (in->flags & HAS_VALID ? 4 : 2); i++) {
        ect_real far = ends[i] - p->start;
        if ((far < R(0) ? -far : far) / period > R(1e9)) {
            return 0;
        }
    }
    return 1;
}

static ect_error load_profiles(ect *e, const sections *s)
{
    uint32_t i, k, used = 0, first = 0;
    for (i = 0; i < s->count[PROFILES]; i++) {
        const uint8_t *r = s->at[PROFILES] + i * RECORD[PROFILES], *before = r - RECORD[PROFILES];
        ect_profile *p = &e->profiles[i];
        uint32_t flags = u32_at(r + 4), count = u32_at(r + 12);
        ect_real step = real_at(r + 24);
        int32_t input;
        e->where = i;
        input = i32_at(r);
        p->periodic = (uint8_t)(flags & 1u);
        p->start = real_at(r + 16);
        p->inverse_step = real_at(r + 32);
        p->inverse_turn = real_at(r + 40);
        p->scale = real_at(r + 48);
        if (u32_at(r + 8) != used || count > s->count[VALUES] - used || count < 1 || flags > 1) {
            return ECT_PROFILE;
        }
        p->values = s->at[VALUES] + 4u * used;
        p->last = (int32_t)count - 1;
        if (input < -1 || (input == -1) != (count == 1) || (input >= 0 && (uint32_t)input >= s->count[INPUTS])) {
            return ECT_PROFILE;
        }
        if (!is_number(p->start) || !is_positive(step) || !is_positive(p->scale) || !is_error_bound(r + 56)
            || !is_error_bound(r + 64)) {
            return ECT_PROFILE;
        }
#ifdef ECT_SINGLE
        if (!is_within(r + 32, R(1.1e15)) || !is_near(p->inverse_step * step, R(1)) || !is_within(r + 40, R(1))
            || (p->periodic && !is_near(p->inverse_turn * (ect_real)p->last, R(1)))) {
            return ECT_PROFILE;
        }
#else
        if (!is_stored(r + 32, R(1) / step) || (p->periodic && !is_stored(r + 40, R(1) / (ect_real)p->last))) {
            return ECT_PROFILE;
        }
#endif
        if (!p->periodic && !is_zero_bits(r + 40, 8)) {
            return ECT_PROFILE;
        }
        for (k = 0; k < count; k++) {
            int32_t v = i32_at(p->values + 4u * k);
            if (v > 1073741823 || v < -1073741823) {
                e->where = used + k;
                return ECT_VALUE;
            }
        }
        if (p->periodic
            && (count < 3 || i32_at(p->values) != i32_at(p->values + 4u * (count - 1))
                || !is_turn_count_small(&e->inputs[input], p, step))) {
            return ECT_PROFILE;
        }
        p->at = input < 0 ? NULL : &e->inputs[input].value;
        p->value = (ect_real)i32_at(p->values) * p->scale;
        p->alike = 0;
        if (i > 0 && input >= 0 && same_bytes(r, before, 8) && same_bytes(r + 12, before + 12, 20)) {
            e->profiles[first].alike += 1;
        } else {
            first = i;
        }
        used += count;
    }
    e->where = used;
    return used == s->count[VALUES] ? ECT_OK : ECT_VALUE;
}

/* Pairs that a cycle sums, those of a component one after another in the order of the table. A component of one pair
 * that is a constant times its profile, never faded, needs no sum: of a constant 1 its place holds -1 - the profile's
 * number until the terms are loaded, which then point at the profile; of a profile without an input it holds -BIG until
 * its value is put there. Before that a place holds how many pairs it has, and then where the next of them goes. */
static void place_pairs(ect *e, const sections *s)
{
    uint32_t i;
    e->pair_count = 0;
    for (i = 0; i < s->count[COMPONENTS]; i++) {
        uint32_t count = (uint32_t)e->components[i];
        e->components[i] = count == 1 ? -BIG : count == 0 ? R(0) : (ect_real)e->pair_count;
        e->pair_count += count == 1 ? 0u : count;
    }
    for (i = 0; i < s->count[PAIRS]; i++) {
        const uint8_t *r = s->at[PAIRS] + i * RECORD[PAIRS];
        ect_profile *profile = &e->profiles[u32_at(r + 4)];
        const ect_node *n = &e->nodes[u32_at(r + 8)];
        ect_real *component = &e->components[u32_at(r)];
        uint32_t keep = u16_at(r + 12);
        ect_pair *p;
        if (*component < R(0)) {
            if (keep && n->op == CONSTANT && is_equal(n->a, R(1))) {
                *component = R(-1) - (ect_real)u32_at(r + 4);
                continue;
            }
            if (keep && n->op == CONSTANT && profile->at == NULL) {
                continue;
            }
            *component = (ect_real)e->pair_count++;
        }
        p = &e->pairs[(uint32_t)*component];
        *component = *component + R(1);
        p->profile = &profile->value;
        p->node = &n->value;
        p->component = component;
        p->keep = keep;
    }
    for (i = 0; i < e->pair_count; i++) { /* the last of each component only */
        if (i + 1 < e->pair_count && e->pairs[i].component == e->pairs[i + 1].component) {
            e->pairs[i].component = NULL;
        } else {
            *e->pairs[i].component = R(0);
        }
    }
}

/* Components that never change get their value. */
static void fix_components(ect *e, const sections *s)
{
    uint32_t i;
    for (i = 0; i < s->count[PAIRS]; i++) {
        const uint8_t *r = s->at[PAIRS] + i * RECORD[PAIRS];
        ect_real *component = &e->components[u32_at(r)];
        if (*component <= -BIG) {
            *component = R(0) + e->profiles[u32_at(r + 4)].value * e->nodes[u32_at(r + 8)].a;
        }
    }
}

static ect_error load_sums(ect *e, const sections *s)
{
    uint32_t i;
    for (i = 0; i < s->count[COMPONENTS]; i++) {
        const uint8_t *r = s->at[COMPONENTS] + i * RECORD[COMPONENTS];
        e->where = i;
        if (!is_text(r, 16, 0, SIGNS_NAME) || !is_unique(s->at[COMPONENTS], RECORD[COMPONENTS], i, 16)
            || u32_at(r + 16) > 1 || u32_at(r + 20) != 0) {
            return ECT_COMPONENT;
        }
        e->components[i] = R(0);
    }
    for (i = 0; i < s->count[PAIRS]; i++) {
        const uint8_t *r = s->at[PAIRS] + i * RECORD[PAIRS];
        e->where = i;
        if (u32_at(r) >= s->count[COMPONENTS] || u32_at(r + 4) >= s->count[PROFILES] || u32_at(r + 8) >= s->count[NODES]
            || u32_at(r + 12) > 1) {
            return ECT_PAIR;
        }
        e->components[u32_at(r)] += R(1); /* until its pairs are placed: how many it has */
    }
    place_pairs(e, s);
    return ECT_OK;
}

static int is_factor(uint32_t units, const uint8_t *factor)
{
    static const uint8_t mm_per_um[8] = {0xFC, 0xA9, 0xF1, 0xD2, 0x4D, 0x62, 0x50, 0x3F};
    static const uint8_t one[8] = {0, 0, 0, 0, 0, 0, 0xF0, 0x3F};
    static const uint8_t deg_per_urad[8] = {0x83, 0x82, 0x60, 0xFE, 0x1B, 0x0A, 0x0E, 0x3F};
    static const uint8_t rad_per_urad[8] = {0x8D, 0xED, 0xB5, 0xA0, 0xF7, 0xC6, 0xB0, 0x3E};
    switch (units) {
    case 0x000:
        return same_bytes(factor, mm_per_um, 8);
    case 0x100:
    case 0x201:
        return same_bytes(factor, one, 8);
    case 0x301:
        return same_bytes(factor, deg_per_urad, 8);
    case 0x401:
        return same_bytes(factor, rad_per_urad, 8);
    default:
        return 0;
    }
}

static ect_error load_outputs(ect *e, const sections *s)
{
    static const ect_real one = R(1);
    uint32_t i, k, used = 0;
    for (i = 0; i < s->count[OUTPUTS]; i++) {
        const uint8_t *r = s->at[OUTPUTS] + i * RECORD[OUTPUTS];
        ect_output *o = &e->outputs[i];
        e->where = i;
        o->flags = u32_at(r + 44);
        o->first = u32_at(r + 48);
        o->count = u32_at(r + 52);
        o->simple = 1;
        o->factor = real_at(r + 56);
        o->magnitude = real_at(r + 64);
        o->slew = real_at(r + 72);
        o->acceleration = real_at(r + 80);
        if (!is_text(r, 32, 0, SIGNS_NAME) || !is_unique(s->at[OUTPUTS], RECORD[OUTPUTS], i, 32)
            || !is_text(r + 32, 8, 1, SIGNS_AXIS) || !is_factor(u32_at(r + 40), r + 56)
            || o->flags > 7) {
            return ECT_OUTPUT;
        }
        if (!is_optional(r + 64, (o->flags & HAS_MAGNITUDE) != 0) || !is_optional(r + 72, (o->flags & HAS_SLEW) != 0)
            || !is_optional(r + 80, (o->flags & HAS_ACCELERATION) != 0)) {
            return ECT_OUTPUT;
        }
        if (o->first != used || o->count < 1 || o->count > s->count[TERMS] - used) {
            return ECT_OUTPUT;
        }
        used += o->count;
    }
    e->where = used;
    if (used != s->count[TERMS]) {
        return ECT_TERM;
    }
    for (i = 0; i < s->count[TERMS]; i++) {
        const uint8_t *r = s->at[TERMS] + i * RECORD[TERMS];
        ect_term *t = &e->terms[i];
        e->where = i;
        t->count = u32_at(r + 4);
        t->weight = real_at(r + 24);
        if (u32_at(r) >= s->count[COMPONENTS] || t->count > 4 || !is_number(t->weight)) {
            return ECT_TERM;
        }
        t->component = &e->components[u32_at(r)];
        if (*t->component < R(0) && *t->component > -BIG) {
            t->component = &e->profiles[(uint32_t)(R(-1) - *t->component)].value;
        }
        for (k = 0; k < 4; k++) {
            uint32_t number = u32_at(r + 8 + 4 * k);
            if (k < t->count ? number >= s->count[NODES] : number != 0xFFFFFFFFu) {
                return ECT_TERM;
            }
            t->node[k] = k < t->count ? &e->nodes[number].value : &one;
        }
    }
    for (i = 0; i < s->count[OUTPUTS]; i++) {
        ect_output *o = &e->outputs[i];
        for (k = o->first; k < o->first + o->count; k++) {
            o->simple = o->simple && e->terms[k].count <= 1;
        }
    }
    fix_components(e, s);
    return ECT_OK;
}

static ect_error load_all(ect *e, const sections *s)
{
    ect_error error = load_inputs(e, s);
    if (error == ECT_OK) {
        error = load_nodes(e, s);
    }
    if (error == ECT_OK) {
        error = load_profiles(e, s);
    }
    if (error == ECT_OK) {
        error = load_sums(e, s);
    }
    if (error == ECT_OK) {
        error = load_outputs(e, s);
    }
    return error;
}

ect_error ect_load_any(ect *e, const void *table, size_t size, void *work, size_t work_size)
{
    static const ect nothing;
    const uint8_t *t = table;
    sections s;
    ect_error error;
    uint32_t where = 0;
    *e = nothing;
    if (table == NULL) {
        return ECT_NOT_A_TABLE;
    }
    error = find_sections(t, size, &s, &where);
    e->where = where;
    if (error != ECT_OK) {
        return error;
    }
    e->crc = u32_at(t + 20);
    if (crc_of(t + 24, size - 24) != e->crc) {
        return ECT_CHECKSUM;
    }
    error = load_header(e, t);
    if (error != ECT_OK) {
        return error;
    }
    if (work == NULL || ((uintptr_t)work & 7u) != 0 || lay_out(e, &s, NULL) > work_size) {
        return ECT_WORK;
    }
    lay_out(e, &s, work);
    error = load_all(e, &s);
    if (error != ECT_OK) {
        return error;
    }
    e->table = t;
    e->where = 0;
    e->rules = 1; /* for this reset, which clears the corrections too */
    e->input_count = s.count[INPUTS];
    e->node_count = s.count[NODES];
    e->profile_count = s.count[PROFILES];
    e->component_count = s.count[COMPONENTS];
    e->output_count = s.count[OUTPUTS];
    ect_reset(e);
    e->rules = s.rules;
    return ECT_OK;
}

ect_error ect_load(ect *e, const void *table, size_t size, void *work, size_t work_size)
{
    ect_error error = ect_load_any(e, table, size, work, work_size);
    uint32_t i;
    for (i = 0; error == ECT_OK && i < e->output_count; i++) {
        const ect_output *o = &e->outputs[i];
        if (!(o->flags & HAS_MAGNITUDE) || o->magnitude > R(ECT_MOST)
            || !(o->flags & HAS_SLEW) || o->slew > R(ECT_MOST)) {
            static const ect nothing;
            *e = nothing;
            e->where = i;
            error = ECT_UNLIMITED;
        }
    }
    return error;
}

static const uint8_t *output_at(const ect *e, uint32_t number)
{
    return e->table + u32_at(e->table + 320 + 16 * OUTPUTS + 12) + number * RECORD[OUTPUTS];
}

void ect_reset(ect *e)
{
    uint32_t i;
    for (i = 0; i < e->input_count; i++) {
        ect_input *in = &e->inputs[i];
        in->wait = in->good = in->age = in->now = in->value = R(0);
        in->raw = in->anchor = BIG * R(10); /* not sane: nothing was read yet */
        in->left = R(1);
        in->rejected = 0;
        in->seen = in->fault = in->source = 0;
        in->usable = in->flags & OPTIONAL ? 1 : 0;
    }
    for (i = 0; i < e->node_count; i++) {
        e->nodes[i].value = e->nodes[i].memory = R(0);
        e->nodes[i].ready = 0;
        e->nodes[i].stated = 0;
    }
    for (i = 0; i < e->output_count; i++) {
        ect_output *o = &e->outputs[i];
        if (e->rules == 1) {
            o->limited = e->ramp = R(0);
        }
        o->rate = o->deviation = R(0);
        o->goal = o->limited;
        o->correction = o->limited * o->factor;
    }
    e->fade = R(-1);
    e->until_slow = 0;
    e->unready = e->node_count;
    e->status = 0;
    e->heartbeat = 0;
}

int ect_take_over(ect *e, const ect *before)
{
    uint32_t i;
    if (e->table == NULL || before->table == NULL || e->output_count != before->output_count) {
        return 0;
    }
    for (i = 0; i < e->output_count; i++) {
        const uint8_t *ours = output_at(e, i), *theirs = output_at(before, i);
        if (!same_bytes(ours, theirs, 32) || u32_at(ours + 40) != u32_at(theirs + 40)) {
            return 0;
        }
    }
    for (i = 0; i < e->output_count; i++) {
        e->outputs[i].limited = e->outputs[i].goal = before->outputs[i].limited;
        e->outputs[i].correction = before->outputs[i].correction;
    }
    e->ramp = before->ramp;
    return 1;
}

/* readings (5) ----------------------------------------------------------------------------------- */

/* Does a reading lie where its rate and noise let it be? The anchor follows it at that rate. */
static int follows(const ect *e, ect_input *in, int fresh)
{
    ect_real reach = in->max_rate * in->age, moved = in->raw - in->anchor, far = moved < R(0) ? -moved : moved;
    if (in->seen || e->rules > 1) {
        if (far > reach + in->noise) {
            if (!in->seen) {
                in->anchor = in->raw;
                in->age = R(0);
            } else if (fresh) {
                in->rejected += 1;
            }
            return 0;
        }
        if (!in->seen && in->age < R(0.5) * e->thermal) {
            return 0;
        }
        if (far > reach) {
            in->anchor = in->anchor + (moved < R(0) ? -reach : reach);
            return 1;
        }
    }
    in->anchor = in->raw;
    return 1;
}

static uint8_t judge(const ect *e, ect_input *in, int fresh)
{
    int within = in->raw >= in->low && in->raw <= in->high; /* then it is sane too */
    if (!within && !is_sane(in->raw)) {
        return 1;
    }
    if ((in->flags & HAS_STALE) && in->wait > in->stale_after) {
        return 2;
    }
    if (!within) {
        return 3;
    }
    return (in->flags & HAS_MAX_RATE) && !follows(e, in, fresh) ? 4 : 0;
}

static uint32_t stand_in(ect *e, ect_input *in)
{
    uint32_t k;
    int whole = in->count > 0;
    in->source = 3;
    if (in->flags & OPTIONAL) {
        in->now = in->fallback;
        return 0;
    }
    for (k = in->first; k < in->first + in->count; k++) {
        if (e->inputs[e->substitutes[k].number].fault != 0) {
            whole = 0;
        }
    }
    if (whole) {
        ect_real v = in->offset;
        for (k = in->first; k < in->first + in->count; k++) {
            v = v + e->substitutes[k].weight * e->inputs[e->substitutes[k].number].good;
        }
        if (v < in->low) {
            v = in->low;
        }
        if (v > in->high) {
            v = in->high;
        }
        in->now = v;
        in->usable = 1;
        in->source = 1;
        return ECT_SUBSTITUTED;
    }
    if (in->seen && (!(in->flags & HAS_HOLD) || in->age < in->hold)) {
        in->now = in->good;
        in->source = 2;
        return ECT_HELD;
    }
    in->now = in->fallback;
    return ECT_DEFAULTED | (in->flags & FADE_ON_DEFAULT ? LOST : 0u);
}

/* A new reading in its range that follows the one before: nothing else is to be judged. */
static int is_plain(const ect *e, const ect_input *in, ect_real reading)
{
    ect_real reach, moved;
    if (!(reading >= in->low && reading <= in->high)) {
        return 0;
    }
    if (!(in->flags & HAS_MAX_RATE)) {
        return 1;
    }
    reach = in->max_rate * (in->age + e->cycle);
    moved = reading - in->anchor;
    return in->seen && moved <= reach && moved >= -reach;
}

static void take(ect_input *in, ect_real reading)
{
    in->good = in->now = in->raw = reading;
    in->age = R(0);
    in->seen = 1; /* four bytes side by side: one store */
    in->usable = 1;
    in->fault = 0;
    in->source = 0;
}

static uint32_t condition(ect *e, const ect_real *readings, const uint8_t *fresh)
{
    uint32_t i, status = 0, doubtful = 0;
    for (i = 0; i < e->input_count; i++) {
        ect_input *in = &e->inputs[i];
        int is_new = fresh == NULL || fresh[i];
        if (is_new) {
            in->wait = R(0);
            if (is_plain(e, in, readings[i])) {
                in->anchor = readings[i];
                take(in, readings[i]);
                continue;
            }
            in->raw = readings[i];
        } else {
            in->wait = in->wait + e->cycle;
        }
        in->age = in->age + e->cycle;
        in->fault = judge(e, in, is_new);
        in->source = 0;
        if (in->fault == 0) {
            take(in, in->raw);
        } else {
            doubtful = 1;
        }
    }
    for (i = 0; doubtful && i < e->input_count; i++) {
        if (e->inputs[i].fault != 0) {
            status |= stand_in(e, &e->inputs[i]);
        }
    }
    return status;
}

/* What the table sees of an input; the lesser of `least` and what its validity leaves of the correction. */
static ect_real show_one(const ect *e, ect_input *in, ect_real least)
{
    ect_real v = in->now, o;
    if (in->flags & HAS_VALID) {
        in->left = R(1);
        o = v < in->valid_low ? in->valid_low - v : v - in->valid_high;
        if (o > R(0)) {
            in->left = R(1) - o / in->margin;
            if (e->rules > 1) {
                v = v < in->valid_low ? in->valid_low : in->valid_high;
            }
        }
    }
    in->value = v;
    return in->left < least ? in->left : least;
}

/* What the table sees of the inputs; the least that the validity of one leaves of the correction. */
static ect_real show(ect *e, int thermal)
{
    uint32_t i;
    ect_real least;
    if (thermal) {
        e->left_slow = R(1);
        for (i = 0; i < e->input_count; i++) {
            if (e->inputs[i].slow) {
                e->left_slow = show_one(e, &e->inputs[i], e->left_slow);
            }
        }
    }
    least = e->left_slow;
    for (i = e->quick; i < e->input_count; i = e->inputs[i].next) {
        least = show_one(e, &e->inputs[i], least);
    }
    return least;
}

/* nodes (6) -------------------------------------------------------------------------------------- */

static ect_real lookup(const ect_real *values, int32_t last, ect_real s)
{
    int32_t j;
    if (s < R(0)) {
        s = R(0);
    }
    if (s > (ect_real)last) {
        s = (ect_real)last;
    }
    j = (int32_t)s;
    if (j > last - 1) {
        j = last - 1;
    }
    return values[j] + (s - (ect_real)j) * (values[j + 1] - values[j]);
}

static int is_far(ect_real a, ect_real b, ect_real threshold) { return a - b > threshold || b - a > threshold; }

/* Undo what the last reading did where it is alone between two that agree, or alone states a direction. */
static void recall(ect_node *n, ect_real u, ect_real threshold, int stated, int started)
{
    int far;
    if (!started) {
        n->c = n->d = u;
    }
    far = is_far(u, n->c, threshold);
    if (started && (n->changed || (n->departed && far)) && !is_far(u, n->d, threshold)) {
        n->value = n->kept_value;
        n->memory = n->kept_memory;
        far = 0;
    }
    n->kept_value = n->value;
    n->kept_memory = n->memory;
    n->departed = far && n->steady;
    n->steady = !far;
    n->changed = stated != 0 && stated != n->stated;
    n->stated = (int8_t)stated;
    n->d = n->c;
    n->c = u;
}

static ect_real side_of(ect_node *n, ect_real u, ect_real known)
{
    ect_real y = n->value;
    if (known > R(0)) {
        n->memory = u;
        return R(1);
    }
    if (known < R(0)) {
        n->memory = u;
        return R(-1);
    }
    if (y > R(0)) {
        if (u >= n->memory) {
            n->memory = u;
        } else if (n->memory - u > n->a) {
            n->memory = u;
            return R(-1);
        }
    } else if (u <= n->memory) {
        n->memory = u;
    } else if (u - n->memory > n->a) {
        n->memory = u;
        return R(1);
    }
    return y;
}

static ect_real run_node(ect *e, ect_node *n, int started)
{
    const ect_weighted *of = e->operands + n->first;
    const ect_node *nodes = e->nodes;
    ect_real u = n->count > 0 ? nodes[of[0].number].value : R(0), before, y = n->value, way;
    uint32_t k;
    switch (n->op) {
    case CONSTANT:
        return n->a;
    case INPUT:
        return e->inputs[n->other].value;
    case AFFINE:
        u = n->a;
        for (k = 0; k < n->count; k++) {
            u = u + of[k].weight * nodes[of[k].number].value;
        }
        return u;
    case FIRST:
        return started ? y : u;
    case LAG:
        before = n->memory;
        n->memory = u;
        if (!started) {
            n->kept_value = R(0);
            return n->flags & START_ZERO ? R(0) : u;
        }
        way = before >= y ? n->c : n->d;
#ifdef ECT_SINGLE
        if (way < R(0)) {
            return creep(n, before, -way);
        }
#endif
        return before + (y - before) * way;
    case PRODUCT:
        for (k = 1; k < n->count; k++) {
            u = u * nodes[of[k].number].value;
        }
        return u;
    case POWER:
        return power_of(u, n->a);
    case CLIP:
        return u < n->a ? n->a : u > n->b ? n->b : u;
    case SWITCH:
        return u >= n->a ? R(1) : u <= n->b ? R(0) : y;
    case DIRECTION:
        way = n->count > 1 ? nodes[of[1].number].value : R(0);
        if (!started) {
            n->value = n->b;
            n->memory = u;
        }
        if (e->rules > 1) {
            recall(n, u, n->a, (way > R(0)) - (way < R(0)), started);
        }
        return side_of(n, u, way);
    case APPROACH:
        if (e->rules > 1) {
            recall(n, u, n->b, 0, started);
        }
        y = n->value;
        way = u - n->memory;
        n->memory = u;
        u = nodes[of[1].number].value;
        if (!started) {
            return u;
        }
        if (way < R(0)) {
            way = -way;
        }
        return way > R(0) ? u - (u - y) * exp_of(-(way / n->a)) : y;
    default:
        return lookup(e->lookups + n->other, (int32_t)n->others - 1, (u - n->a) * n->c);
    }
}

static uint8_t is_ready(const ect *e, const ect_node *n)
{
    uint8_t ready = n->op == INPUT ? e->inputs[n->other].usable : 1;
    uint32_t k;
    for (k = n->first; k < n->first + n->count; k++) {
        ready = ready && e->nodes[e->operands[k].number].ready;
    }
    return ready;
}

static uint32_t run_nodes(ect *e, int slow)
{
    uint32_t i = 0, status = 0, count = slow ? e->node_count : e->fast_count;
    for (; !slow && i < e->fast_inputs; i++) { /* a reading is sane */
        ect_node *n = &e->nodes[e->fast[i]];
        const ect_input *in = &e->inputs[n->other];
        if (!n->ready && in->usable) {
            n->ready = 1;
            e->unready -= 1;
        }
        n->value = in->value;
    }
    for (; i < count; i++) {
        ect_node *n = &e->nodes[slow ? i : e->fast[i]];
        int started = n->ready;
        ect_real value;
        if (!started && is_ready(e, n)) {
            n->ready = 1;
            e->unready -= 1;
        }
        value = run_node(e, n, started);
        if (!is_sane(value)) {
            value = R(0);
            status |= ECT_NOT_FINITE;
        }
        n->value = value;
    }
    return e->unready > 0 ? status | ECT_WAITING : status;
}

/* profiles and sums (7) -------------------------------------------------------------------------- */

static ect_real move(const ect *e, ect_real x, ect_real goal, ect_real whole)
{
    ect_real step;
    if (whole <= R(0) || is_equal(x, goal)) {
        return goal;
    }
    step = e->cycle / whole;
    return goal > x + step ? x + step : goal < x - step ? x - step : goal;
}

static uint32_t run_fade(ect *e, ect_real target)
{
    if (!(target > R(0))) {
        target = R(0);
    }
    e->fade = move(e, e->fade, target, e->fade < R(0) ? R(0) : e->fade_time);
    return (e->fade < R(1) ? ECT_FADING : 0u) | (e->fade <= R(0) ? ECT_FADED : 0u);
}

static uint32_t run_profiles(ect *e)
{
    uint32_t status = 0;
    ect_profile *p = e->profiles, *end = p + e->profile_count, *last;
    for (; p < end; p = last) {
        ect_real n = (ect_real)p->last, s, f;
        int32_t j, left, right;
        last = p + p->alike + 1;
        if (p->at == NULL) {
            continue; /* its value is fixed */
        }
        s = (*p->at - p->start) * p->inverse_step;
        if (p->periodic) {
            ect_real t = s * p->inverse_turn;
            int32_t k = (int32_t)t;
            if (t < (ect_real)k) {
                k -= 1;
            }
            s = s - (ect_real)k * n;
        } else if (s < R(0) || s > n) {
            status |= ECT_BEYOND_PROFILE;
        }
        if (s < R(0)) {
            s = R(0);
        }
        if (s > n) {
            s = n;
        }
        j = (int32_t)s;
        if (j > p->last - 1) {
            j = p->last - 1;
        }
        f = s - (ect_real)j;
        for (; p < last; p++) {
            left = i32_at(p->values + 4 * (ptrdiff_t)j);
            right = i32_at(p->values + 4 * (ptrdiff_t)j + 4);
            p->value = ((ect_real)left + f * (ect_real)(right - left)) * p->scale;
        }
    }
    return status;
}

static uint32_t run_sums(ect *e)
{
    uint32_t i, m, status = 0;
    const ect_real fade = e->fade;
    ect_real sum = R(0);
    const ect_pair *p = e->pairs, *pairs_end = p + e->pair_count;
    const ect_term *t = e->terms, *terms_end;
    for (; p < pairs_end; p++) {
        ect_real part = *p->profile * *p->node;
        if (!p->keep) {
            part = part * fade;
        }
        sum = sum + part;
        if (p->component != NULL) {
            *p->component = sum;
            sum = R(0);
        }
    }
    for (i = 0; i < e->output_count; i++) {
        ect_output *o = &e->outputs[i];
        ect_real d = R(0);
        terms_end = t + o->count;
        if (o->simple) {
            for (; t < terms_end; t++) {
                d = d + t->weight * *t->component * *t->node[0]; /* 1 where it has none */
            }
        }
        for (; t < terms_end; t++) {
            ect_real part = t->weight * *t->component * *t->node[0];
            for (m = 1; m < t->count; m++) {
                part = part * *t->node[m];
            }
            d = d + part;
        }
        if (!is_sane(d)) {
            d = R(0);
            status |= ECT_NOT_FINITE;
        }
        o->deviation = d;
    }
    return status;
}

/* limits (8) ------------------------------------------------------------------------------------- */

static int stops(ect_real q, ect_real left, ect_real a) { return q <= R(0) || q * (q - a) <= R(2) * a * left; }

static ect_real closing(ect_real keep, ect_real way, ect_real drift, ect_real lo, ect_real hi, ect_real a)
{
    ect_real forward = way > R(0) ? hi : lo, away = way > R(0) ? lo : hi, sign = way > R(0) ? R(1) : R(-1), half;
    if (keep > hi) {
        keep = hi;
    }
    if (keep < lo) {
        keep = lo;
    }
    if (a <= R(0) || stops(sign * (forward - drift), sign * (way - forward), a)) {
        return forward;
    }
    if (sign * (keep - drift) > R(0) && stops(sign * (keep - drift), sign * (way - keep), a)) {
        return keep;
    }
    if (sign * (away - drift) > R(0)) {
        return away;
    }
    half = drift + R(0.5) * (way - drift);
    return half < lo ? lo : half > hi ? hi : half;
}

static uint32_t approach_goal(const ect *e, ect_output *o, ect_real goal)
{
    ect_real way = goal - o->limited, drift = goal - o->goal, lo = -BIG, hi = BIG, a = R(0), before, most;
    int arrives;
    o->goal = goal;
    if (o->flags & HAS_SLEW) {
        hi = o->slew * e->cycle;
        lo = -hi;
    }
    if (o->flags & HAS_ACCELERATION) {
        a = o->acceleration * e->cycle * e->cycle;
        if (o->rate + a < hi) {
            hi = o->rate + a;
        }
        if (o->rate - a > lo) {
            lo = o->rate - a;
        }
    }
    arrives = lo <= way && way <= hi;
    if (arrives && a > R(0)) {
        arrives = -a <= way - drift && way - drift <= a;
    }
    if (arrives) {
        o->rate = way;
        o->limited = goal;
        return 0;
    }
    before = o->limited;
    o->rate = closing(o->rate, way, drift, lo, hi, a);
    o->limited = before + o->rate;
    most = before < R(0) ? -before : before; /* beyond its magnitude where another table left it: comes back at its rate */
    most = most > o->magnitude ? most : o->magnitude;
    if (e->rules > 1 && (o->flags & HAS_MAGNITUDE) && (o->limited > most || o->limited < -most)) {
        o->limited = o->limited > R(0) ? most : -most;
        o->rate = o->limited - before;
        return ECT_AT_RATE | ECT_AT_MAGNITUDE;
    }
    return ECT_AT_RATE;
}

static uint32_t run_limits(ect *e, int hold)
{
    uint32_t i, status = e->ramp >= R(1) ? ECT_ACTIVE : e->ramp > R(0) ? ECT_RAMPING : 0u;
    for (i = 0; i < e->output_count; i++) {
        ect_output *o = &e->outputs[i];
        ect_real goal = -o->deviation * e->ramp;
        if (o->flags & HAS_MAGNITUDE) {
            if (goal > o->magnitude) {
                goal = o->magnitude;
                status |= ECT_AT_MAGNITUDE;
            }
            if (goal < -o->magnitude) {
                goal = -o->magnitude;
                status |= ECT_AT_MAGNITUDE;
            }
        }
        if (hold) {
            o->rate = R(0);
            o->goal = goal;
        } else if (o->flags & (HAS_SLEW | HAS_ACCELERATION)) {
            status |= approach_goal(e, o, goal);
        } else {
            o->limited = goal;
        }
        o->correction = o->limited * o->factor;
    }
    return status;
}

void ect_cycle(ect *e, const ect_real *readings, const uint8_t *fresh, int mode)
{
    uint32_t status;
    int slow;
    ect_real left;
    if (e->table == NULL) {
        return;
    }
    slow = e->until_slow == 0;
    e->until_slow = (slow ? e->slow_every : e->until_slow) - 1;
    status = ECT_RUNNING | condition(e, readings, fresh);
    left = show(e, slow);
    status |= run_nodes(e, slow);
    status |= run_fade(e, status & LOST ? R(0) : left);
    status |= run_profiles(e);
    status |= run_sums(e);
    if (mode == ECT_HOLD) {
        status |= ECT_HOLDING;
    } else {
        e->ramp = move(e, e->ramp, mode == ECT_ON ? R(1) : R(0), e->ramp_time);
    }
    status |= run_limits(e, mode == ECT_HOLD);
    e->status = status & ~LOST;
    e->heartbeat += 1;
}

ect_real ect_correction(const ect *e, uint32_t output)
{
    return output < e->output_count ? e->outputs[output].correction : R(0);
}

/* names ------------------------------------------------------------------------------------------ */

static int32_t find(const uint8_t *records, uint32_t record, uint32_t count, const char *name)
{
    uint32_t i, k;
    for (i = 0; i < count; i++) {
        const uint8_t *own = records + i * record;
        for (k = 0; k < 32 && own[k] == (uint8_t)name[k]; k++) {
            if (own[k] == 0) {
                return (int32_t)i;
            }
        }
    }
    return -1;
}

int32_t ect_find_input(const ect *e, const char *name)
{
    return e->table == NULL ? -1 : find(e->table + HEADER, e->rules == 1 ? (uint32_t)RECORD_INPUT_1 : RECORD[INPUTS], e->input_count, name);
}

int32_t ect_find_output(const ect *e, const char *name)
{
    if (e->table == NULL) {
        return -1;
    }
    return find(output_at(e, 0), RECORD[OUTPUTS], e->output_count, name);
}

const char *ect_says(ect_error error)
{
    static const char *const words[] = {
        "sound", "not a compensation table", "damaged by a transfer in text mode", "cut off or too long",
        "another format version", "damaged (checksum)", "header: cycles, times, texts or reserved bytes",
        "a section's size or place", "an input", "a substitute", "a node", "an operand", "a lookup value", "a profile",
        "a profile value", "a component", "a pair", "an output", "a term", "work area too small or not aligned",
        "another table than the one allowed", "an output without magnitude or slew, or with one above ECT_MOST"};
    return (unsigned)error <= (unsigned)ECT_UNLIMITED ? words[error] : "unknown error";
}
