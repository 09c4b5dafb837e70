/* A table in constant memory over the cycles of case.h (made by the test): prints every correction's bits. */
#include <stdio.h>
#include <string.h>

#include "case.h" /* TABLE, INPUTS, CYCLES, READINGS */
#include "ect.h"

#define SYSTICK_CONTROL (*(volatile uint32_t *)0xE000E010u)
#define SYSTICK_RELOAD (*(volatile uint32_t *)0xE000E014u)
#define SYSTICK_VALUE (*(volatile uint32_t *)0xE000E018u)

static uint64_t work[WORK / 8 + 1];

int main(void)
{
    ect e;
    unsigned k, i, o;
    ect_error error = ect_load_any(&e, TABLE, sizeof TABLE, work, sizeof work);
    if (error != ECT_OK || e.input_count != INPUTS) {
        printf("refused: %s %u\n", ect_says(error), (unsigned)e.where);
        return 1;
    }
    printf("exact %d\n", ect_arithmetic_is_exact());
    for (k = 0; k < CYCLES; k++) {
        ect_real readings[INPUTS];
        for (i = 0; i < INPUTS; i++) {
            readings[i] = (ect_real)READINGS[k][i];
        }
        ect_cycle(&e, readings, NULL, 1);
        for (o = 0; o < e.output_count; o++) {
            unsigned char bits[sizeof(ect_real)];
            unsigned b;
            memcpy(bits, &e.outputs[o].correction, sizeof bits);
            for (b = sizeof bits; b-- > 0;) {
                printf("%02x", bits[b]);
            }
            printf(" ");
        }
        printf("%u\n", (unsigned)e.status);
    }
#ifdef __arm__
    {
        ect_real readings[INPUTS];
        uint32_t begin, end;
        for (i = 0; i < INPUTS; i++) {
            readings[i] = (ect_real)READINGS[0][i];
        }
        SYSTICK_RELOAD = 0xFFFFFFu;
        SYSTICK_VALUE = 0;
        SYSTICK_CONTROL = 5;
        begin = SYSTICK_VALUE;
        for (k = 0; k < 100; k++) {
            ect_cycle(&e, readings, NULL, 1);
        }
        end = SYSTICK_VALUE;
        /* 25 MHz ticks at one instruction per ns: 40 instructions a tick */
        fprintf(stderr, "%u instructions per cycle\n", (unsigned)(((begin - end) & 0xFFFFFFu) * 40u / 100u));
    }
#endif
    return 0;
}
