/* A table in constant memory over the cycles of case.h (made by the test): prints every correction's bits; on a board
 * also the instructions of a cycle whose readings stay, and those of the slowest cycle of case.h. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "case.h" /* TABLE, INPUTS, CYCLES, READINGS, FRESH, MODE */
#include "ect.h"

#ifdef __arm__
#define SYSTICK_CONTROL (*(volatile uint32_t *)0xE000E010u)
#define SYSTICK_RELOAD (*(volatile uint32_t *)0xE000E014u)
#define SYSTICK_VALUE (*(volatile uint32_t *)0xE000E018u)

static void start_ticks(void)
{
    SYSTICK_RELOAD = 0xFFFFFFu;
    SYSTICK_VALUE = 0;
    SYSTICK_CONTROL = 5;
}

static uint32_t ticks(void)
{
    return SYSTICK_VALUE; /* counts down, at 25 MHz: 40 instructions a tick at one instruction per ns */
}
#else
static void start_ticks(void)
{
}

static uint32_t ticks(void)
{
    return 0;
}
#endif

static uint64_t work[WORK / 8 + 1];

static void convert(ect_real *readings, unsigned k)
{
    unsigned i;
    for (i = 0; i < INPUTS; i++) {
        readings[i] = (ect_real)READINGS[k][i];
    }
}

static void print_bits(const ect *e)
{
    unsigned o;
    for (o = 0; o < e->output_count; o++) {
        unsigned char bits[sizeof(ect_real)];
        unsigned b;
        memcpy(bits, &e->outputs[o].correction, sizeof bits);
        for (b = sizeof bits; b-- > 0;) {
            printf("%02x", bits[b]);
        }
        printf(" ");
    }
    printf("%u\n", (unsigned)e->status);
}

int main(void)
{
    ect e;
    ect_real readings[INPUTS];
    unsigned k;
    uint32_t begin, took, slowest = 0;
    ect_error error = ect_load_any(&e, TABLE, sizeof TABLE, work, sizeof work);
    if (error != ECT_OK || e.input_count != INPUTS) {
        printf("refused: %s %u\n", ect_says(error), (unsigned)e.where);
        return 1;
    }
    printf("exact %d\n", ect_arithmetic_is_exact());
    start_ticks();
    for (k = 0; k < CYCLES; k++) {
        convert(readings, k);
        begin = ticks();
        ect_cycle(&e, readings, FRESH[k], MODE[k]);
        took = (begin - ticks()) & 0xFFFFFFu;
        slowest = took > slowest ? took : slowest;
        print_bits(&e);
    }
    convert(readings, 0);
    begin = ticks();
    for (k = 0; k < 100; k++) {
        ect_cycle(&e, readings, NULL, 1);
    }
    took = ((begin - ticks()) & 0xFFFFFFu) * 40u / 100u;
    fprintf(stderr, "%u instructions per cycle, %u in the slowest\n", (unsigned)took, (unsigned)((slowest + 1) * 40u));
    return 0;
}
