#include "feedback_inject.h"

#define SEVERAL 4 /* counts by which the threshold of a direction must exceed the lost motion: noise of an encoder at rest */

/* Place in the cycle 00 10 11 01 (A first), counting up. */
static uint8_t place(uint8_t wires)
{
    uint8_t a = wires & 1u, b = (uint8_t)(wires >> 1) & 1u;
    return (uint8_t)(b << 1 | (a ^ b));
}

static uint8_t wires_of(uint8_t at)
{
    uint8_t b = (uint8_t)(at >> 1) & 1u;
    return (uint8_t)((((at & 1u) ^ b) ? INJECT_A : 0u) | (b ? INJECT_B : 0u));
}

void inject_start(inject *e, uint32_t gap)
{
    e->counts = e->injected = e->aim = 0;
    e->illegal = e->waiting = 0;
    e->gap = gap < INJECT_LEAST_GAP ? INJECT_LEAST_GAP : gap;
    e->since = e->gap;
    e->in = e->out = e->z = e->found = e->started = 0;
}

void inject_aim(inject *e, int32_t counts) { e->aim = counts; }

void inject_seek(inject *e) { e->found = 0; }

uint8_t inject_step(inject *e, uint8_t wires, uint8_t enabled)
{
    uint8_t now = place(wires), z = (wires & INJECT_Z) ? 1 : 0;
    uint8_t moved = (uint8_t)(now - e->in) & 3u;
    int32_t goal;
    if (!e->started) {
        e->started = 1;
        e->in = e->out = now;
        e->z = z;
        return wires & (INJECT_A | INJECT_B | INJECT_Z);
    }
    e->in = now;
    if (moved == 1u) {
        e->counts++;
        e->out = (e->out + 1u) & 3u;
    } else if (moved == 3u) {
        e->counts--;
        e->out = (e->out + 3u) & 3u;
    } else if (moved == 2u) {
        e->illegal++;
    }
    if (z && !e->z && e->injected == 0) {
        e->found = 1;
    }
    e->z = z;
    e->since += e->since < e->gap ? 1u : 0u;
    goal = e->found ? e->aim : 0;
    if (enabled && e->injected != goal && e->since >= e->gap) {
        if (moved != 0u) {
            e->waiting++;
        } else {
            int32_t step = e->injected < goal ? 1 : -1;
            e->injected += step;
            e->out = (uint8_t)(e->out + (step > 0 ? 1u : 3u)) & 3u;
            e->since = 0;
        }
    }
    return (uint8_t)(wires_of(e->out) | (z ? INJECT_Z : 0u));
}

int inject_fits(uint32_t speed, uint32_t period) { return (uint64_t)speed * period <= UINT64_C(900000000); }

int8_t inject_travel(inject_side *e, int32_t counts, int32_t threshold)
{
    int32_t way = counts - e->furthest;
    if (e->side == 0) {
        if (way >= threshold || way <= -threshold) {
            e->side = way > 0 ? 1 : -1;
            e->furthest = counts;
        }
    } else if ((e->side > 0) == (way > 0)) {
        e->furthest = counts;
    } else if (way >= threshold || way <= -threshold) {
        e->side = (int8_t)-e->side;
        e->furthest = counts;
    }
    return e->side;
}

int inject_side_fits(int32_t threshold, int32_t lost_motion) { return threshold >= lost_motion + SEVERAL; }
