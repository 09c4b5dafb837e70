/* What the tests call in a shared library: the runtime over many cycles, and over mutated tables. */
#include <stdlib.h>
#include <string.h>

#include "ect.h"

int load(const void *table, size_t size, uint32_t *where)
{
    size_t need = ect_work_size(table, size);
    void *work = malloc(need + 8);
    ect e;
    ect_error error = ect_load_any(&e, table, size, work, need);
    *where = e.where;
    free(work);
    return (int)error;
}

int stream(const void *table, size_t size, size_t cycles, const ect_real *readings, const uint8_t *fresh,
           const uint8_t *mode, ect_real *deviation, ect_real *correction, uint32_t *status)
{
    size_t need = ect_work_size(table, size), k;
    void *work = malloc(need + 8);
    ect e;
    ect_error error = ect_load_any(&e, table, size, work, need);
    for (k = 0; error == ECT_OK && k < cycles; k++) {
        uint32_t o;
        ect_cycle(&e, readings + k * e.input_count, fresh == NULL ? NULL : fresh + k * e.input_count,
                  mode == NULL ? ECT_ON : mode[k]);
        for (o = 0; o < e.output_count; o++) {
            deviation[k * e.output_count + o] = e.outputs[o].deviation;
            correction[k * e.output_count + o] = e.outputs[o].correction;
        }
        status[k] = e.status;
    }
    free(work);
    return (int)error;
}

static uint64_t next_random(uint64_t *state)
{
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    return *state;
}

static uint32_t crc_of(const uint8_t *p, size_t size)
{
    uint32_t crc = 0xFFFFFFFFu;
    size_t i;
    int k;
    for (i = 0; i < size; i++) {
        crc ^= p[i];
        for (k = 0; k < 8; k++) {
            crc = crc >> 1 ^ (crc & 1u ? 0xEDB88320u : 0u);
        }
    }
    return ~crc;
}

static void run_some(const void *table, size_t size)
{
    static const double odd[8] = {0.0, -1.0, 1e30, -1e30, 1e31, 0.0 / 1.0, 123.456, -987.0};
    size_t need = ect_work_size(table, size);
    void *work = malloc(need + 8);
    ect e;
    int k;
    uint32_t i;
    if (ect_load_any(&e, table, size, work, need) == ECT_OK) {
        ect_real readings[64];
        for (k = 0; k < 5; k++) {
            for (i = 0; i < e.input_count; i++) {
                const ect_input *in = &e.inputs[i];
                readings[i] = k % 2 ? (ect_real)odd[(i + (uint32_t)k) % 8] : k == 2 ? in->high : in->low;
            }
            ect_cycle(&e, readings, NULL, k % 3);
        }
    }
    free(work);
}

/* Damage a table in many ways, with a mended checksum, and load and run what is left. The copy has exactly the size it
 * claims, so that a sanitizer sees the first byte read behind it. Returns how many were accepted. */
size_t mutate(const uint8_t *table, size_t size, size_t count, uint64_t seed)
{
    uint64_t state = seed * 2654435761u + 88172645463325252u;
    size_t n, accepted = 0;
    for (n = 0; n < count; n++) {
        size_t length = next_random(&state) % 50 == 0 ? (size_t)(next_random(&state) % (size + 1)) : size;
        uint8_t *copy = malloc(length ? length : 1);
        uint64_t changes = 1 + next_random(&state) % 3, c;
        uint32_t where;
        memcpy(copy, table, length);
        for (c = 0; length > 0 && c < changes; c++) {
            size_t at = (size_t)(next_random(&state) % length), wide = (size_t)1 << next_random(&state) % 4;
            uint64_t kind = next_random(&state) % 4, value = next_random(&state);
            if (next_random(&state) % 3) {
                at = at / wide * wide;
            }
            for (; wide > 0 && at < length; wide--, at++, value >>= 8) {
                copy[at] = kind == 0 ? (uint8_t)value : kind == 1 ? 0xFF : kind == 2 ? 0 : (uint8_t)(copy[at] + 1);
            }
        }
        if (length >= 24 && next_random(&state) % 10) {
            uint32_t crc, total = (uint32_t)length;
            memcpy(copy + 16, &total, 4);
            crc = crc_of(copy + 24, length - 24);
            memcpy(copy + 20, &crc, 4);
        }
        accepted += load(copy, length, &where) == ECT_OK;
        run_some(copy, length);
        free(copy);
    }
    return accepted;
}

/* A session: a table that runs over many calls, is reset, and is exchanged for another one while it runs. */
typedef struct {
    ect active;
    void *work;
    void *bytes;
} session;

static ect_error begin(session *s, const void *table, size_t size)
{
    size_t need = ect_work_size(table, size);
    s->work = malloc(need + 8);
    s->bytes = malloc(size);
    memcpy(s->bytes, table, size);
    return ect_load_any(&s->active, s->bytes, size, s->work, need);
}

void *session_open(const void *table, size_t size)
{
    session *s = malloc(sizeof *s);
    return begin(s, table, size) == ECT_OK ? s : NULL;
}

int session_reload(session *s, const void *table, size_t size)
{
    session spare;
    if (begin(&spare, table, size) != ECT_OK || !ect_take_over(&spare.active, &s->active)) {
        free(spare.work);
        free(spare.bytes);
        return 0;
    }
    free(s->work);
    free(s->bytes);
    *s = spare;
    return 1;
}

void session_reset(session *s) { ect_reset(&s->active); }

void session_run(session *s, size_t cycles, const ect_real *readings, const uint8_t *fresh, const uint8_t *mode,
                 ect_real *correction, uint32_t *status)
{
    size_t k;
    for (k = 0; k < cycles; k++) {
        uint32_t o;
        ect_cycle(&s->active, readings + k * s->active.input_count, fresh + k * s->active.input_count, mode[k]);
        for (o = 0; o < s->active.output_count; o++) {
            correction[k * s->active.output_count + o] = s->active.outputs[o].correction;
        }
        status[k] = s->active.status;
    }
}

void session_close(session *s)
{
    free(s->work);
    free(s->bytes);
    free(s);
}
