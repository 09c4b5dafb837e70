/* Compensation tables on a controller: check a table in place, then evaluate it once per cycle.
 *
 * Format and arithmetic: ect-2.md (versions 2 and 1). C99, one source file, no allocation, freestanding: nothing from the C
 * library but memcpy, and memset where a compiler turns clearing into it. Compile with -ffp-contract=off: with fused multiply-adds results differ in their last bits
 * (ect_arithmetic_is_exact() tells). -DECT_SINGLE computes in float and needs no double anywhere.
 *
 *     static uint64_t work[4096];
 *     ect e;
 *     if (ect_load(&e, table, size, work, sizeof work) != ECT_OK) { say so: corrections are 0 }
 *     each position cycle:  ect_cycle(&e, readings, NULL, ECT_ON);  command_x += ect_correction(&e, 0);
 *
 * A table is changed while the machine runs by loading the new one into a second `ect` (in a slower task), then, between
 * two cycles, ect_take_over(&second, &first): corrections go on from where they stand, within their limits.
 *
 * The bytes of the table must stay where they are, unchanged, as long as it is used (read-only memory is fine).
 */
#ifndef ECT_H
#define ECT_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#ifdef ECT_SINGLE
typedef float ect_real;
#else
typedef double ect_real;
#endif

typedef enum {
    ECT_OK = 0,
    ECT_NOT_A_TABLE,    /* does not start with the magic bytes */
    ECT_TEXT_MODE,      /* a transfer changed its line ends */
    ECT_CUT_OFF,        /* fewer or more bytes than it says */
    ECT_VERSION,        /* another format version */
    ECT_CHECKSUM,       /* damaged */
    ECT_HEADER,         /* cycles, ramp, fade, texts or reserved bytes */
    ECT_SECTION,        /* size, number or place of a section; ect.where is its id */
    ECT_INPUT,          /* from here on ect.where is the number of the record */
    ECT_SUBSTITUTE,
    ECT_NODE,
    ECT_OPERAND,
    ECT_LOOKUP,
    ECT_PROFILE,
    ECT_VALUE,
    ECT_COMPONENT,
    ECT_PAIR,
    ECT_OUTPUT,
    ECT_TERM,
    ECT_WORK,           /* the work area is too small or not aligned to 8 bytes */
    ECT_FOREIGN,        /* another table than the one allowed (ect_load_only in ect_identity.h) */
    ECT_UNLIMITED       /* ect.where is the number of an output without magnitude or slew, or with one above ECT_MOST */
} ect_error;

enum { /* status bits */
    ECT_RUNNING = 1, ECT_ACTIVE = 2, ECT_RAMPING = 4, ECT_SUBSTITUTED = 8, ECT_HELD = 16, ECT_DEFAULTED = 32,
    ECT_FADING = 64, ECT_FADED = 128, ECT_AT_MAGNITUDE = 256, ECT_AT_RATE = 512, ECT_BEYOND_PROFILE = 1024,
    ECT_WAITING = 2048, ECT_NOT_FINITE = 4096, ECT_HOLDING = 8192
};

typedef enum {
    ECT_OFF = 0,  /* corrections go to 0: before homing, or where none is wanted */
    ECT_ON = 1,
    ECT_HOLD = 2  /* corrections stay as they are: emergency stop, drives without power */
} ect_mode;

typedef struct {
    ect_real low, high, max_rate, stale_after, hold, fallback, offset, valid_low, valid_high, margin;
    ect_real noise, raw, wait, good, age, anchor, now, left;
    ect_real value;         /* what the table computes with */
    uint32_t first, count;
    uint32_t rejected;      /* readings refused because they moved too fast */
    uint16_t flags;
    uint8_t slow;           /* shown to the table in thermal cycles only */
    uint8_t next;           /* input behind it that is shown in every cycle; in a slow one unused */
    uint8_t seen, usable;
    uint8_t fault;          /* 0 none, 1 missing, 2 stale, 3 range, 4 rate */
    uint8_t source;         /* 0 reading, 1 substitute, 2 held, 3 default */
} ect_input;

typedef struct {
    ect_real weight;
    uint32_t number;
} ect_weighted;

typedef struct {
    ect_real a, b;
    ect_real c, d;          /* of direction and approach: the last two readings */
    ect_real value, memory;
    ect_real kept_value, kept_memory; /* before the last reading */
    uint32_t first, count, other, others;
    uint16_t op;
    uint8_t flags, ready;
    uint8_t steady, departed, changed;
    int8_t stated;          /* sign of the last direction that was stated */
} ect_node;

typedef struct {
    ect_real start, inverse_step, inverse_turn, scale;
    ect_real value;
    const ect_real *at;     /* value of its input; NULL: its own value is fixed */
    const uint8_t *values;  /* in the table */
    int32_t last;
    uint8_t periodic;
    uint16_t alike; /* profiles behind it on the same grid */
} ect_profile;

typedef struct {
    const ect_real *profile, *node; /* their values */
    ect_real *component;    /* where the sum goes that this pair ends; NULL: it goes on */
    uint32_t keep;
} ect_pair;

typedef struct {
    ect_real factor, magnitude, slew, acceleration;
    ect_real limited, rate, goal;
    ect_real deviation;     /* um or urad */
    ect_real correction;    /* in the output's correction unit, to be added to the command */
    uint32_t first, count, flags;
    uint32_t simple;        /* none of its terms has more than one factor */
} ect_output;

typedef struct {
    ect_real weight;
    const ect_real *component, *node[4]; /* their values */
    uint32_t count;
} ect_term;

typedef struct {
    const uint8_t *table;
    ect_input *inputs;
    ect_weighted *substitutes, *operands;
    ect_node *nodes;
    ect_real *lookups, *components;
    ect_profile *profiles;
    ect_pair *pairs;
    ect_output *outputs;
    ect_term *terms;
    uint32_t *fast;         /* numbers of the nodes of every cycle: those that are an input, then the others */
    uint32_t input_count, node_count, fast_inputs, fast_count, profile_count, component_count, pair_count, output_count;
    uint32_t slow_every, until_slow, unready;
    uint32_t rules;         /* format version by whose rules the table runs */
    ect_real cycle, thermal, ramp_time, fade_time;
    ect_real ramp, fade;
    ect_real left_slow;     /* the least that the validity of a slow input leaves */
    uint32_t status, heartbeat;
    uint32_t quick;         /* the first input that is shown in every cycle */
    uint32_t crc;           /* the table's name */
    uint32_t where;         /* record that was refused */
} ect;

/* Bytes of work area a table needs; 0 if its header is refused. */
size_t ect_work_size(const void *table, size_t size);

/* Largest correction of a table that nobody has named, um or urad, and its largest change in a second: 10 mm is more than any
 * machine tool is wrong by, and 10 um a millisecond more than any axis asks of its correction: what is faster is a jump. */
#ifndef ECT_MOST
#define ECT_MOST 10000
#endif

/* Check everything and prepare. On any error the table is not used: ect_cycle then gives corrections of 0. Tables whose
 * corrections have no magnitude or no slew, or one above ECT_MOST, are refused; ect_load_any takes those too, for a table
 * that the machine's builder knows, and ect_load_only (ect_identity.h) for one that the site names. */
ect_error ect_load(ect *e, const void *table, size_t size, void *work, size_t work_size);
ect_error ect_load_any(ect *e, const void *table, size_t size, void *work, size_t work_size);

/* The next cycle is the first of a run: states and references start anew; corrections go on from where they stand. */
void ect_reset(ect *e);

/* Before the first cycle of e: go on with the corrections and the ramp of `before`, which may be dropped then. Returns 0,
 * and changes nothing, unless both have outputs of the same names and units in the same order. */
int ect_take_over(ect *e, const ect *before);

/* One position cycle. readings: one per input, in the order of the table; fresh: non-zero where the reading is new
 * since the last cycle (NULL: all are); mode: an ect_mode. Results: e->outputs[], e->status, e->heartbeat. */
void ect_cycle(ect *e, const ect_real *readings, const uint8_t *fresh, int mode);

/* Correction of an output, in its correction unit, to be added to the command. 0 where there is no such output, as after a
 * table that was refused: e->outputs points nowhere then. */
ect_real ect_correction(const ect *e, uint32_t output);

/* Number of the input or output of a name, -1 if there is none. */
int32_t ect_find_input(const ect *e, const char *name);
int32_t ect_find_output(const ect *e, const char *name);

/* 1 if this build adds and multiplies with one rounding each (see -ffp-contract above). */
int ect_arithmetic_is_exact(void);

/* The error in words, for a display. */
const char *ect_says(ect_error error);

#ifdef __cplusplus
}
#endif
#endif
