/* An encoder that moves at random, rests, dithers and breaks, the core behind it, and a counter of its own behind that.
 *
 * argv: edges, seed. The counter decodes the output without the core's help and knows legal transitions by a table of
 * its own. Prints what happened; whoever reads it judges. */
#include <stdio.h>
#include <stdlib.h>

#include "feedback_inject.h"

static uint64_t state;

static uint32_t random32(void)
{
    state = state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return (uint32_t)(state >> 33);
}

/* What a quadrature counter makes of old and new A, B: 2 is illegal. */
static int change(unsigned before, unsigned after)
{
    static const int table[4][4] = {{0, 1, -1, 2}, {-1, 0, 2, 1}, {1, 2, 0, -1}, {2, -1, 1, 0}};
    return table[before & 3u][after & 3u];
}

int main(int n, char **a)
{
    static const unsigned gray[4] = {0, INJECT_A, INJECT_A | INJECT_B, INJECT_B};
    const long long edges = n > 1 ? atoll(a[1]) : 1000;
    long long done = 0, raw = 0, seen = 0, illegal = 0, fast = 0, early = 0, shifted = 0, thawed = 0, jumps = 0, indices = 0;
    long long last = -1000, periods = 0, injections = 0, wrong = 0, rest = 0, way = 1;
    unsigned before, wires = 0, out;
    int enabled = 1, injected = 0, found = 0;
    inject e;
    state = n > 2 ? (uint64_t)atoll(a[2]) : 1;
    inject_start(&e, 0);
    inject_aim(&e, 37);
    before = inject_step(&e, 0, 1) & 3u;
    while (done < edges) {
        uint32_t r = random32();
        int seek = 0, was = e.injected, index = 0;
        if (rest > 0) {
            rest--;
        } else {
            raw += way;
            done++;
            if ((r & 1023u) == 0) {
                way = -way;
            }
            rest = (r >> 10 & 63u) == 0 ? (long long)(r >> 16 & 255u) : (long long)(r >> 16 & 3u);
        }
        index = ((raw % 1000) + 1000) % 1000 == 0;
        if ((r & 0xFFFFu) == 7u) {
            inject_aim(&e, (int32_t)(random32() % 201u) - 100);
        }
        if ((r & 0x3FFFFu) == 9u) {
            enabled = !enabled;
        }
        if ((r & 0xFFFFFu) == 11u) {
            inject_seek(&e);
            seek = 1;
            found = 0;
        }
        wires = gray[((raw % 4) + 4) % 4] | (index ? INJECT_Z : 0u);
        out = inject_step(&e, (uint8_t)wires, (uint8_t)enabled);
        periods++;
        int moved = change(before, out);
        illegal += moved == 2;
        seen += moved == 2 ? 0 : moved;
        before = out & 3u;
        shifted += ((out & INJECT_Z) != 0) != index;
        injected = e.injected;
        if (injected != was) {
            injections++;
            fast += periods - last < (long long)INJECT_LEAST_GAP;
            last = periods;
            thawed += !enabled;
            jumps += abs(injected - was) > 1;
        }
        early += !found && !seek && abs(injected) > abs(was); /* before the index counts may only be taken back */
        if (index && was == 0) {
            found = 1;
        }
        indices += index;
        wrong += seen - raw != injected; /* after each single period, not only at the end */
    }
    printf("edges %lld periods %lld indices %lld injections %lld illegal %lld wrong %lld fast %lld early %lld shifted %lld "
           "thawed %lld jumps %lld core_illegal %lu difference %lld\n",
           done, periods, indices, injections, illegal, wrong, fast, early, shifted, thawed, jumps,
           (unsigned long)e.illegal, seen - raw - injected);
    return 0;
}
