/* Counts added to or taken from a quadrature signal between an encoder and its controller.
 *
 * Freestanding C99: no library, no floating point, no allocation. inject_step runs once per period, the shortest in
 * which two edges of the encoder can follow each other; inject_aim whenever there is a new correction.
 *
 * Sign    counts = -correction * counts per mm, rounded: where the axis must go 10 um less far, the controller is shown
 *         10 um more than the encoder reads, and brings the axis back by them.
 * Edges   the output changes by one edge a period at most, so its phases are always legal. An edge of the encoder goes
 *         first; counts are added or taken only in periods in which the encoder stands still.
 * Index   passed in the period in which it comes. Nothing is injected before the first index after `found` was cleared,
 *         so that the controller finds its zero where the encoder has it.
 * Frozen  while not enabled (emergency stop) what is injected stays: it is never taken away, nothing jumps at the reset.
 */
#ifndef FEEDBACK_INJECT_H
#define FEEDBACK_INJECT_H

#include <stdint.h>

#define INJECT_LEAST_GAP 10u /* periods between two injected counts: 10 % of the largest count rate */

typedef struct {
    int32_t counts;   /* counted at the input since the start */
    int32_t injected; /* output minus input */
    int32_t aim;      /* where `injected` is going */
    uint32_t illegal; /* transitions of the input that skip a phase: a broken wire, or too fast for the period */
    uint32_t waiting; /* periods in which a count was due and the encoder took the edge */
    uint32_t gap;     /* least periods between two injected counts */
    uint32_t since;   /* periods since the last one, at most gap */
    uint8_t in;       /* place in the quadrature cycle, 0..3 */
    uint8_t out;
    uint8_t z;
    uint8_t found; /* the index has come */
    uint8_t started;
} inject;

typedef struct {
    int32_t furthest;
    int8_t side; /* +1 or -1, 0 before the first travel */
} inject_side;

#define INJECT_A 1u
#define INJECT_B 2u
#define INJECT_Z 4u

/* gap: periods between two injected counts; less than INJECT_LEAST_GAP counts as that. */
void inject_start(inject *e, uint32_t gap);

/* New aim, in counts. */
void inject_aim(inject *e, int32_t counts);

/* Before homing: what is injected is taken back count by count, then nothing until the next index. */
void inject_seek(inject *e);

/* One period. wires: INJECT_A | INJECT_B | INJECT_Z of the encoder; the return value is those for the controller. */
uint8_t inject_step(inject *e, uint8_t wires, uint8_t enabled);

/* Whether `speed` counts per second fit a step of `period` nanoseconds, with every tenth period left for injection. */
int inject_fits(uint32_t speed, uint32_t period);

/* Direction of travel from counts, where the controller does not tell it: it turns after `threshold` counts against it.
 * The threshold must exceed the lost motion by several counts; inject_side_fits says whether it does. */
int8_t inject_travel(inject_side *e, int32_t counts, int32_t threshold);
int inject_side_fits(int32_t threshold, int32_t lost_motion);

#endif
